"""Contact forces of the robot on a person whose tracked head and hands jump."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.tracking.jumps import MAX_LINEAR_SPEED_M_S, RETURN_SPEED_FRACTION
from helpers.vr.visit import Visit

SPREAD_M = 0.6
IMPACT_KG, CONTACT_S = 10.0, 0.02
"""Upper bound of the effective mass of arm and person, and the time constant of simulated contacts."""
IMPACT_N = 2.0 * IMPACT_KG * MAX_LINEAR_SPEED_M_S * RETURN_SPEED_FRACTION / CONTACT_S
"""Impact force at the speed of a returning limb. A critically damped contact starts with the force 2 m v / t."""

Frames = Callable[[int, TrackingFrameMessage, np.random.Generator], TrackingFrameMessage | None]


def random_pose_near(pose: XRPose, rng: np.random.Generator, spread_m: float = SPREAD_M) -> XRPose:
    """Return a random pose within ``spread_m`` of another, in any orientation."""
    x, y, z = (np.array(pose.position) + rng.uniform(-spread_m, spread_m, 3)).tolist()
    turn = rng.normal(size=4)
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return XRPose((x, y, z), (qx, qy, qz, qw))


def teleport(tracking: TrackingFrameMessage, rng: np.random.Generator) -> TrackingFrameMessage:
    """Return a frame with random poses of head and hands."""
    assert tracking.head is not None
    assert tracking.left is not None
    assert tracking.right is not None
    head, left, right = (
        random_pose_near(pose, rng) for pose in (tracking.head, tracking.left, tracking.right)
    )
    return msgspec.structs.replace(tracking, head=head, left=left, right=right)


def _hold(every: int, shown: int) -> Frames:
    """Jump every ``every`` ticks; the pose is tracked for the first ``shown`` ticks."""
    last: list[TrackingFrameMessage] = []

    def frames(
        tick: int, tracking: TrackingFrameMessage, rng: np.random.Generator
    ) -> TrackingFrameMessage | None:
        if tick % every == 0:
            last[:] = [teleport(tracking, rng)]
        if tick % every >= shown:
            return None
        poses = {name: getattr(last[0], name) for name in ("head", "left", "right")}
        return msgspec.structs.replace(tracking, **poses)

    return frames


PATTERNS: dict[str, Callable[[], Frames]] = {
    "everywhere": lambda: lambda tick, tracking, rng: teleport(tracking, rng),
    "for a while": lambda: _hold(every=15, shown=15),
    "after absence": lambda: _hold(every=25, shown=3),
}
"""Jumps at every tick; jumps that last until they are accepted; and jumps after lost tracking."""


def peak_force_n(folder: Path, environment: str, seed: int, pattern: str, *, steps: int) -> float:
    """Return the peak contact force on the person in a trial, N; a name that is not in ``PATTERNS`` means rest."""
    trial = TrialPlan(environment, "revised", seed, practice=False)
    session = SessionPlan([trial], "woman", 0.2, is_simulated=True, trial_steps=steps, countdown_s=0.1)
    visit, rng = Visit(folder, session, load_policies(session)), np.random.default_rng(seed)
    visit.participant.adopt_posture(environment)
    visit.calibrate()
    visit.run_until("trial")
    visit.tracking = False
    frames = PATTERNS[pattern]() if pattern in PATTERNS else lambda tick, tracking, rng: tracking
    peak_n, tick = 0.0, 0
    while visit.phase == "trial":
        tracking = frames(tick, visit.frame(), rng)
        visit.send(*([] if tracking is None else [tracking]))
        visit.tick()
        state, tick = visit.session.world.simulation.get_state(), tick + 1
        peak_n = max(peak_n, float(state.robot_force_n[0] + state.tool_force_n[0]))
    visit.leave()
    return peak_n
