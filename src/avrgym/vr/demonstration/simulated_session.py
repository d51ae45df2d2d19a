"""Demonstrations by a simulated demonstrator, in simulated time."""

from collections.abc import Callable

from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.vr.demonstration.session import DemonstrationSession
from avrgym.vr.emulation.simulated_demonstrator import SimulatedDemonstrator
from avrgym.vr.protocol.messages import TICK_S, DemonstrationCommand

START_BUTTON_DELAY_S = 0.5
"""Time in seconds from a new world to the button ``start``."""
SUCCESS_BUTTON_DELAY_S = 0.7
"""Time in seconds from the task's success to the button ``success``."""


def record_simulated_demonstrations(
    session: DemonstrationSession,
    seed: int,
    progress: Callable[[], None] = lambda: None,
) -> None:
    """Records all episodes of a session with a planned number of episodes. ``progress`` is called after each
    episode."""
    demonstrator = SimulatedDemonstrator(seed, corrects=session.plan.policy != OPERATOR_POLICY_NAME)
    ticks, waited_s, stage = 0, 0.0, session.stage
    while session.stage != "finished":
        now_s = ticks * TICK_S
        if session.stage == "running":
            succeeded = session.attempt is not None and session.attempt.success
            session.receive(demonstrator.make_controller_message(session.world, now_s), now_s)
        else:
            succeeded = False
        waited_s = waited_s + TICK_S if succeeded or session.stage == "ready" else 0.0
        if session.stage == "ready" and waited_s > START_BUTTON_DELAY_S:
            demonstrator.begin_episode(session.world)
            session.receive(DemonstrationCommand("start"), now_s)
            waited_s = 0.0
        elif succeeded and waited_s > SUCCESS_BUTTON_DELAY_S:
            session.receive(DemonstrationCommand("success"), now_s)
        session.tick(now_s)
        session.wait_for_writes()
        if stage == "running" and session.stage != "running":
            progress()
            waited_s = 0.0
        stage = session.stage
        ticks += 1
    session.close(ticks * TICK_S)
