"""Messages that a session sends continuously: states of the world, touches, successes, and the session's status."""

from avrgym.models.body_names import TRACKED_BODY_PARTS
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.recording.input_profile import InputProfile
from avrgym.simulation.worlds import Simulation
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.vr.live_world.arm_contact import ArmContactMonitor
from avrgym.vr.live_world.drivers import Driver, OperatorDriver
from avrgym.vr.live_world.obstruction import ObstructionMonitor
from avrgym.vr.live_world.scene_message import find_most_loaded_region
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import TICK_S, MessageSender
from avrgym.vr.session.attempt import Attempt
from avrgym.vr.session.headset_time import HeadsetTime
from avrgym.vr.tracking.tracking_state import TrackingState

STATUS_INTERVAL_TICKS = 20
TOOL_FORCE_INTERVAL_TICKS = 4
"""Interval in ticks at which the contact force of the tool is sent if it has changed."""

NO_FEEDBACK = messages.HapticAndAudioFeedback(left_touched=False, right_touched=False, events=0)


class StateReporter:
    """Sends states and feedback of the current world. Call ``tick`` once per tick."""

    def __init__(self, send: MessageSender, state_interval_ticks: int = 1) -> None:
        """Create a reporter that sends a state every ``state_interval_ticks`` ticks.

        If the interval is above 1, a state at the end of a control step is sent a tick later.
        """
        self._send, self._state_every_ticks = send, state_interval_ticks
        self._ticks, self._state_due = 0, state_interval_ticks
        self._felt = NO_FEEDBACK
        self._force_n = 0.0
        self._touched = False, False
        self._world: LiveWorld | None = None

    @property
    def is_status_due(self) -> bool:
        """Whether the session must send its status in this tick."""
        return self._ticks % STATUS_INTERVAL_TICKS == 0

    def tick(self, world: LiveWorld, tracking: TrackingState, step: FirstWorldStep | None) -> None:
        """Send the state of the world after a tick. ``tracking``: the tracking that moved the body in this tick."""
        self._ticks += 1
        if world is not self._world:
            self._world, self._touch = world, ArmContactMonitor(world.simulation)
            self._obstruction = ObstructionMonitor(world.simulation, world.skeleton)
        if self._ticks % DEFAULT_SUBSTEPS == 0:
            self._touched = self._touch.detect_touched_arms()
        self._send_feedback(step)
        if self._ticks % TOOL_FORCE_INTERVAL_TICKS == 0:
            self._send_tool_force(world)
        if self._ticks >= self._state_due and (step is None or self._state_every_ticks == 1):
            self._state_due = self._ticks + self._state_every_ticks
            self._send(self.make_state(world, tracking))

    def make_state(self, world: LiveWorld, tracking: TrackingState) -> messages.WorldState:
        """Returns the state of the world after the latest tick."""
        deviating = {*tracking.deviating_parts, *self._obstruction.detect_obstructed_parts()}
        return messages.WorldState(
            sequence_number=self._ticks,
            simulation_time_s=self._ticks * TICK_S,
            tracking_sequence_number=tracking.applied_sequence_number,
            joint_targets=world.joint_targets_rad.astype("<f4").tobytes(),
            deviating_parts=[part for part in TRACKED_BODY_PARTS if part in deviating],
            poses=world.encode_poses(),
        )

    def _send_tool_force(self, world: LiveWorld) -> None:
        """Sends the contact force of the tool if it has changed."""
        force_n = round(float(world.simulation.get_tool_net_force_n()[0]), 1)
        if force_n != self._force_n:
            self._force_n = force_n
            self._send(messages.ToolForce(force_n))

    def _send_feedback(self, step: FirstWorldStep | None) -> None:
        """Send haptic and acoustic feedback when touches begin or end, and when the task succeeds."""
        events = int(step.outcome.num_events[0]) if step is not None else 0
        felt = messages.HapticAndAudioFeedback(*self._touched, events)
        if felt != self._felt or events:
            self._felt = felt
            self._send(felt)


def make_status(
    phase: messages.PhaseDescription, attempt: Attempt | None, world: LiveWorld, tracking: TrackingState, now_s: float,
    *, steps: int, paused: bool, why: str, driver: Driver, latency: list[messages.StageLatency],
    streams: list[messages.StreamStatus], visibility: messages.Visibility, profile: InputProfile,
    headset_time: HeadsetTime,
) -> messages.SessionStatus:  # fmt: skip
    """Returns the status message of a session.

    ``steps``: number of control steps of a trial. ``paused``: whether no trial may start. ``why``: the reason of a stop
    rule, or empty.
    """
    left, right = tracking.hand_modalities
    region, share = find_most_loaded_region(world.simulation)
    latest = attempt.latest_step.outcome if attempt is not None and attempt.latest_step is not None else None
    return messages.SessionStatus(
        phase=phase.name,
        trial=phase.trial,
        trials=phase.trials,
        attempt=attempt.number if attempt else 0,
        environment=world.environment_id,
        paused=paused,
        pause_reason=why,
        torso_height_m=world.person.torso_height_m,
        step=attempt.steps if attempt else 0,
        steps=steps,
        reward=attempt.total_reward if attempt else 0.0,
        success=attempt.success if attempt else False,
        distance_m=float(latest.distance_m[0]) if latest else 0.0,
        force_on_person_n=float(latest.force_on_person_n[0]) if latest else 0.0,
        force_region=region,
        force_share=share,
        retracting=phase.name == "trial" and world.guard is not None and bool(world.guard.retracting_mask[0]),
        withdrawing=phase.name == "trial" and world.is_withdrawing,
        tracking_age_s=tracking.compute_newest_frame_age_s(now_s),
        visibility=visibility,
        left_modality=left,
        right_modality=right,
        needed_parts=[part for part in world.task.tracked_body_parts if profile.needs_tracking(part)],
        untracked_parts=[part for part in tracking.untracked_parts if profile.needs_tracking(part)],
        operated=isinstance(driver, OperatorDriver),
        idle=driver.is_idle or bool(tracking.untracked_needed_parts),
        latency=latency,
        streams=streams,
        headset_s=headset_time.total_s,
        headset_limit_s=headset_time.limit_s,
        break_is_due=headset_time.is_break_due,
    )


def make_viewer_status(
    simulation: Simulation, latest: FirstWorldStep | None, *, environment: str, torso_height_m: float, episode: int,
    step: int, steps: int, reward: float, success: bool, operated: bool, idle: bool, paused: bool = False,
    retracting: bool = False,
) -> messages.SessionStatus:  # fmt: skip
    """Returns the status message of episodes without a participant. ``latest``: the latest control step."""
    region, share = find_most_loaded_region(simulation)
    outcome = latest.outcome if latest is not None else None
    return messages.SessionStatus(
        phase="viewing",
        trial=episode,
        trials=0,
        attempt=1,
        environment=environment,
        paused=paused,
        pause_reason="",
        torso_height_m=torso_height_m,
        step=step,
        steps=steps,
        reward=reward,
        success=success,
        distance_m=float(outcome.distance_m[0]) if outcome else 0.0,
        force_on_person_n=float(outcome.force_on_person_n[0]) if outcome else 0.0,
        force_region=region,
        force_share=share,
        retracting=retracting,
        withdrawing=False,
        tracking_age_s=None,
        needed_parts=[],
        untracked_parts=[],
        visibility="visible",
        left_modality="none",
        right_modality="none",
        operated=operated,
        idle=idle,
        latency=[],
        streams=[],
    )
