"""Tracking of heads and hands that teleport, and how hard the robot then presses on the person."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np

from avrgym.vr.protocol.messages import Tracking, XRPose
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.tracking.jumps import MAX_SPEED_M_S, RETURN_SHARE
from helpers.vr.visit import Visit

SPREAD_M = 0.6
IMPACT_KG, CONTACT_S = 10.0, 0.02
"""More than arm and person together bring into an impact, and the time constant of contacts in the simulation."""
IMPACT_N = 2.0 * IMPACT_KG * MAX_SPEED_M_S * RETURN_SHARE / CONTACT_S
"""What stops so much at the speed of a limb that returns: a critically damped contact begins with force 2 m v / t."""

Frames = Callable[[int, Tracking, np.random.Generator], Tracking | None]


def random_pose_near(pose: XRPose, rng: np.random.Generator, spread_m: float = SPREAD_M) -> XRPose:
    """A pose anywhere about another, turned anyhow."""
    x, y, z = (np.array(pose.position) + rng.uniform(-spread_m, spread_m, 3)).tolist()
    turn = rng.normal(size=4)
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return XRPose((x, y, z), (qx, qy, qz, qw))


def teleport(tracking: Tracking, rng: np.random.Generator) -> Tracking:
    """A frame whose head and hands are elsewhere."""
    assert tracking.head is not None
    assert tracking.left is not None
    assert tracking.right is not None
    head, left, right = (
        random_pose_near(pose, rng) for pose in (tracking.head, tracking.left, tracking.right)
    )
    return msgspec.structs.replace(tracking, head=head, left=left, right=right)


def _hold(every: int, shown: int) -> Frames:
    """Another place every so many ticks, tracked for the first few of them."""
    last: list[Tracking] = []

    def frames(tick: int, tracking: Tracking, rng: np.random.Generator) -> Tracking | None:
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
"""At every tick; for as long as is needed to be believed; and found elsewhere after not being tracked."""


def peak_force_n(folder: Path, environment: str, seed: int, pattern: str, *, steps: int) -> float:
    """The strongest force, N, on the person in any tick of a trial under an attack of this name, else at rest."""
    trial = TrialPlan(environment, "revised", seed, practice=False)
    session = SessionPlan([trial], "woman", 0.2, simulated=True, trial_steps=steps, countdown_s=0.1)
    visit, rng = Visit(folder, session, load_policies(session)), np.random.default_rng(seed)
    visit.participant.take_place(environment)
    visit.calibrate()
    visit.run_until("trial")
    visit.tracking = False
    frames = PATTERNS[pattern]() if pattern in PATTERNS else lambda tick, tracking, rng: tracking
    peak_n, tick = 0.0, 0
    while visit.phase == "trial":
        tracking = frames(tick, visit.frame(), rng)
        visit.send(*([] if tracking is None else [tracking]))
        visit.tick()
        state, tick = visit.session.world.simulation.state(), tick + 1
        peak_n = max(peak_n, float(state.robot_force_n[0] + state.tool_force_n[0]))
    visit.leave()
    return peak_n
