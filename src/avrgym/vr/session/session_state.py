"""The state that all phases of a session share."""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec
import numpy as np

from avrgym.commands.vocabulary import ROBOT_COMMANDS, CommandName, CommandSource
from avrgym.models import human
from avrgym.models.body_names import TrackedBodyPart
from avrgym.models.furniture.real_furniture import (
    REQUIRED_FURNITURE_POINTS,
    FurniturePoint,
    measure_furniture,
)
from avrgym.models.human import BODY_DIMENSIONS, SKIN_TONES, Person
from avrgym.questionnaires.stop_rules import StopDecision
from avrgym.recording import schema
from avrgym.recording.configuration import HeadsetCheck
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.reader import RecordingError
from avrgym.recording.schema import AttemptEnd
from avrgym.safety.force_guard import INTERVENTION_EVENT, RELEASE_EVENT
from avrgym.safety.withdrawal import WITHDRAWAL_EVENT
from avrgym.tasks.registry import describe_missing_arm, find_environment
from avrgym.texts.interface_texts import ParticipantText
from avrgym.vr.latency import compute_percentiles_ms, has_all_stages
from avrgym.vr.live_world.drivers import Driver, OperatorDriver
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import MessageSender
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.session import events
from avrgym.vr.session.attempt import make_attempt_configuration
from avrgym.vr.session.attempt_storage import AttemptStorage
from avrgym.vr.session.events import EventSink
from avrgym.vr.session.head_commands import HeadCommandDetector
from avrgym.vr.session.headset_time import HeadsetTime
from avrgym.vr.session.interruptions import UNTRACKED_TIMEOUT_S
from avrgym.vr.session.participant_input import ParticipantInput
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.preference_questions import (
    PreferenceQuestion,
    find_possible_questions,
    replace_preferences,
)
from avrgym.vr.session.trial_drivers import TrialDrivers
from avrgym.vr.session.trial_worlds import TrialWorlds
from avrgym.vr.tracking.tracking_state import TrackingState

NOT_IN_VR_TEXT = ParticipantText("waiting")
"""The value of ``absence_text`` before the participant has entered VR."""
NO_ROBOT_COMMANDS = messages.AvailableRobotCommands([], [], "", 1.0, 0.0)
LATENCY_WINDOW_S = 5
"""Duration in seconds of the time window for the latency statistics on the experimenter's page."""


@dataclass
class SessionState:
    """The state of a session that all phases share.

    ``drivers``: the drivers of the robots. ``event_sink``: reports the events. ``attempt_storage``: records the
    attempts. ``trial_worlds``: the simulated worlds. ``trial_index`` is the index of the plan's trial, from 0.
    ``person`` is the participant's virtual body. ``participant_input``: the participant's input profile.
    ``headset_time``: the time in VR. ``tracking``: the tracking since the participant entered VR.
    ``torso_height_known``: whether the body has the participant's torso height. ``calibrated_posture``: the posture
    during calibration.

    ``is_paused``: whether no trial may start, because the experimenter paused the session or an answer met a stop rule.
    ``pause_reason``: the reason of the stop rule, or empty. ``is_ended_by_stop_rule``: whether a stop rule ends the
    session. ``ready_trial_index``: index of the trial that the participant confirmed last with the trigger.
    ``absence_text``: the text with the reason why the participant is not in VR; ``None`` in VR. ``visibility``: whether
    the participant sees the scene. ``headset_check_result``: result of the latest headset check. ``headset_checked``:
    whether the check passed or was skipped. ``now_s``: time since the session's start.
    """

    plan: SessionPlan
    drivers: TrialDrivers
    session_id: str
    send: MessageSender
    event_sink: EventSink
    attempt_storage: AttemptStorage
    trial_worlds: TrialWorlds
    trial_index: int
    person: Person
    participant_input: ParticipantInput = field(default_factory=ParticipantInput)
    headset_time: HeadsetTime = field(default_factory=HeadsetTime)
    tracking: TrackingState = field(default_factory=TrackingState)
    torso_height_known: bool = False
    calibrated_posture: human.Posture | None = None
    is_paused: bool = False
    pause_reason: str = ""
    is_ended_by_stop_rule: bool = False
    ready_trial_index: int = -1
    absence_text: ParticipantText | None = NOT_IN_VR_TEXT
    visibility: messages.Visibility = "visible"
    headset_check_result: HeadsetCheck | None = None
    headset_checked: bool = False
    now_s: float = 0.0

    def __post_init__(self) -> None:
        self._sent_scene = self.make_scene_message()
        self._guard_interventions, self._guard_acts, self._withdrew = 0, False, False
        self.available_commands = NO_ROBOT_COMMANDS
        self._points: dict[FurniturePoint, tuple[float, float, float]] = {}
        self.head_command_detector: HeadCommandDetector | None = None
        self._latencies: deque[schema.Latency] = deque(maxlen=LATENCY_WINDOW_S)
        self.stage_latencies: list[messages.StageLatency] = []

    @property
    def current_trial(self) -> TrialPlan:
        """The running or next trial; after all trials, the last trial."""
        return self.plan.trials[min(self.trial_index, len(self.plan.trials) - 1)]

    @property
    def driver(self) -> Driver:
        """The driver of the current trial."""
        return self.drivers.find_driver(self.current_trial)

    @property
    def world(self) -> LiveWorld:
        """The world that the clients show now."""
        return self.trial_worlds.world

    @property
    def needed_body_parts(self) -> tuple[TrackedBodyPart, ...]:
        """The parts of the body that the task needs, without the participant's resting arms."""
        return tuple(
            part
            for part in self.world.task.tracked_body_parts
            if self.participant_input.profile.needs_tracking(part)
        )

    @property
    def untracked_part(self) -> TrackedBodyPart | None:
        """The first needed part of the body that was untracked for ``UNTRACKED_TIMEOUT_S``."""
        needed = self.needed_body_parts
        return next(
            (p for p in needed if self.tracking.compute_part_pose_age_s(p, self.now_s) > UNTRACKED_TIMEOUT_S),
            None,
        )

    @property
    def next_trial_index(self) -> int:
        """The index of the next trial. After an open questionnaire of an earlier session, it is the first trial."""
        return max(self.trial_index + 1, self.plan.first_trial_number - 1)

    # Messages to the clients ---------------------------------------------------------------------------------------

    def explain_rejection(self, text: ParticipantText) -> None:
        """Show the participant the reason for a rejected request, in their language. The experimenter also receives
        this text."""
        texts = self.plan.texts
        by_input = texts.format_by_select_input(text)
        self.send(
            messages.Problem(texts.format_for_vr(text), "participant", texts.format_for_page(text), by_input)
        )

    def report_problem(self, problem: str) -> None:
        """Send the text ``problem`` to the experimenter's page."""
        self.send(messages.Problem(problem, "experimenter"))

    def record_event(self, name: str, detail: str) -> None:
        """Record an event in the running attempt; without an attempt, do nothing."""
        self.attempt_storage.record_event(name, detail, self.now_s)

    def make_language_message(self) -> messages.Language:
        """Returns the participant's language, with the texts of their page."""
        texts = self.plan.texts
        return messages.Language(texts.language, texts.direction, dict(texts.page))

    def make_scene_message(self) -> messages.Scene:
        """Returns the scene to draw, with the pose of the participant's room if it is known."""
        registration = self.tracking.registration or Registration(np.zeros(3), 0.0)
        return self.world.make_scene_message(self.trial_worlds.scene_number, registration)

    def make_body_message(self) -> messages.ParticipantBody:
        """Returns the participant's body model, and the available skin tones."""
        tones = list(SKIN_TONES), list(SKIN_TONES.values())
        return messages.ParticipantBody(self.person.sex, self.person.skin_tone, *tones)

    def send_changed_scene(self) -> None:
        """Send the scene to all clients if it differs from the last sent scene."""
        scene = self.make_scene_message()
        if scene != self._sent_scene:
            self._sent_scene = scene
            self.send(scene)
            self.send_world_motion(self.send)

    def locate_participant(self, tracking: messages.TrackingFrameMessage) -> None:
        """Add a tracking frame. The first usable frame determines the participant's position and direction."""
        frame = self.tracking.add_frame(tracking, self.now_s)
        if frame.is_usable and self.tracking.registration is None:
            assert tracking.head is not None
            self.tracking.determine_registration(
                tracking.head, self.person, self.world.scene_config.posture, self.plan.furniture
            )
            self.send_changed_scene()

    def send_world_motion(self, send: MessageSender) -> None:
        """Send the target pose of a moving world. The world moves after the participant has slid on the seat."""
        placed = self.tracking.world_motion
        if placed is not None:
            send(placed)

    def move_seat(self) -> None:
        """Move the seat after a participant has slid. Records the start of this motion and each new world pose."""
        before = self.tracking.registration
        glide = self.tracking.move_seat(self.world.joint_targets_rad)
        if glide is not None:
            way_m = float(np.linalg.norm(glide.shift_w))
            self.record_event("seat_followed", f"{way_m:.2f} m")
            self.event_sink.report(events.SeatFollowed(self.now_s, way_m))
            self.send_world_motion(self.send)
        after = self.tracking.registration
        if after is not None and after is not before:
            place = after.xr_from_world()
            self._sent_scene = msgspec.structs.replace(self._sent_scene, xr_from_world=place)
            if self.attempt_storage.attempt is not None:
                pose = schema.Pose(list(place.position), list(place.orientation))
                self.attempt_storage.attempt.record("/placement", schema.Placement(pose), self.now_s)

    def apply_stop_rule(self, decision: StopDecision) -> None:
        """Prevent further trials, because an answer met a stop rule. The current questionnaire is completed first."""
        self.prevent_trials(decision)
        self.record_event("stop_rule_met", decision.reason)
        self.event_sink.report(events.StopRuleMet(self.now_s, decision.action, decision.reason))
        self.report_problem(f"the session {decision.action}s: {decision.reason}")

    def prevent_trials(self, decision: StopDecision) -> None:
        """Pause the session before the next trial, without an event or message. See ``apply_stop_rule``."""
        self.is_paused, self.pause_reason = True, decision.reason
        self.is_ended_by_stop_rule = self.is_ended_by_stop_rule or decision.action == "end"

    def count_headset_time(self, seconds: float) -> None:
        """Add ``seconds`` to the time in VR. Reports a warning when little time is left."""
        if self.absence_text is None:
            self.headset_time.add_time(seconds)
            warning = self.headset_time.pop_warning()
            if warning:
                self.report_problem(warning)

    def report_headset_time(self) -> None:
        """Report the time in VR since the previous report to the observer."""
        seconds = self.headset_time.pop_unstored_time_s()
        if seconds > 0.0:
            self.event_sink.report(events.HeadsetUsed(self.now_s, seconds))

    def request_break(self, by: events.Initiator) -> None:
        """Request a break before the next trial."""
        self.headset_time.request_break()
        self.event_sink.report(events.BreakRequested(self.now_s, by))

    # The participant's body --------------------------------------------------------------------------------------

    def set_torso_height(self, torso_height_m: float) -> None:
        """Change the body's torso height. The participant's position does not change.

        Raises:
            ValueError: for a height outside the range of adults. The message contains the range.
        """
        self.person = replace(self.person, torso_height_m=torso_height_m)
        self.torso_height_known = True
        self.tracking.update_location(self.person)

    def set_arm_scale(self, arm_scale: float) -> None:
        """Change the length of the body's arms. Raises ``ValueError`` outside the range of adults."""
        self.person = replace(self.person, arm_scale=arm_scale)
        self.event_sink.report(events.ReachMeasured(self.now_s, arm_scale))

    def correct_torso_height(self, torso_height_m: float) -> bool:
        """Set the torso height that the experimenter entered. Returns whether it is valid; reports an invalid
        height."""
        try:
            self.set_torso_height(torso_height_m)
        except ValueError as error:
            self.report_problem(str(error))
            return False
        self.event_sink.report(events.TorsoHeightCorrected(self.now_s, torso_height_m))
        return True

    def mark_point(self, point: FurniturePoint) -> None:
        """Store a point of the real seat or mattress. The last required point determines its dimensions; calibration
        follows."""
        position = self.tracking.find_controller_position(self.now_s)
        if position is None:
            self.report_problem(
                "no controller is tracked; hold one at the point in VR and mark the point again"
            )
            return
        self._points[point] = position
        missing = [name for name in REQUIRED_FURNITURE_POINTS if name not in self._points]
        if missing:
            self.report_problem(
                f"{point}: {position[1]:.2f} m above the floor; still to mark: {', '.join(missing)}"
            )
            return
        points, self._points = self._points, {}
        seated = self.world.scene_config.posture.is_seated
        try:
            furniture = measure_furniture(self.plan.furniture, points, seated=seated)
        except ValueError as error:
            self.report_problem(
                f"the points do not measure a {'seat' if seated else 'bed'}: {error}; mark all points again"
            )
            return
        self.plan = replace(self.plan, furniture=furniture)
        self.torso_height_known = False
        self.event_sink.report(events.FurnitureMeasured(self.now_s, furniture))
        self.report_problem(
            f"measured: {furniture.describe(seated=seated)}; now measure the participant again"
        )

    def choose_body(self, choice: messages.BodyChoice, by: events.Initiator) -> bool:
        """Change the participant's body. Returns whether the choice is valid; reports an invalid choice.

        After a change of the sex, the participant must be calibrated again: the torso height is measured from the hips,
        which are higher in the male model.
        """
        try:
            chosen = Person(
                choice.sex, BODY_DIMENSIONS[choice.sex].torso_height_m, skin_tone=choice.skin_tone
            )
            chosen = replace(chosen, absent_arms=self.person.absent_arms)
        except ValueError as error:
            if by == "participant":
                self.explain_rejection(ParticipantText("no_such_body"))
            self.report_problem(str(error))
            return False
        if chosen.sex == self.person.sex:
            measured = self.person
            chosen = replace(chosen, torso_height_m=measured.torso_height_m, arm_scale=measured.arm_scale)
        else:
            self.torso_height_known = False
        self.person = chosen
        self.event_sink.report(events.BodyChosen(self.now_s, chosen.sex, chosen.skin_tone))
        self.send(self.make_body_message())
        return True

    @property
    def preference_questions(self) -> list[PreferenceQuestion]:
        """The questions about preferences in the current trial; empty if the participant may not change them."""
        if not self.current_trial.allow_preference_changes:
            return []
        own = [
            trial.rules
            for trial in self.plan.trials
            if trial.allow_preference_changes and trial.rules is not None
        ]
        return find_possible_questions(own, force_guard=self.plan.has_force_guard)

    def change_preferences(self, changes: dict[str, Any]) -> None:
        """Change the participant's preferences in all trials that use them. ``changes``: values by name."""
        trials = [
            replace(trial, rules=replace_preferences(trial.rules, changes))
            if trial.allow_preference_changes and trial.rules is not None
            else trial
            for trial in self.plan.trials
        ]
        self.plan = replace(self.plan, trials=trials)
        assert self.current_trial.rules is not None
        self.event_sink.report(events.PreferencesChanged(self.now_s, self.current_trial.rules.preferences))

    def change_input_profile(self, profile: InputProfile) -> None:
        """Change the participant's input profile. The next world contains the profile's arms.

        If a remaining task needs an arm that the profile lacks, the change is rejected and a problem is reported.
        """
        remaining = self.plan.trials[self.trial_index :]
        tasks = [
            (find_environment(each.environment)[0], self.plan.find_trial_settings(each)) for each in remaining
        ]
        fault = describe_missing_arm(tasks, profile.absent_arms)
        if fault:
            self.report_problem(fault)
            return
        self.participant_input.profile = profile
        self.person = replace(self.person, absent_arms=profile.absent_arms)
        self.record_event("input_changed", profile.describe())
        self.event_sink.report(events.InputChanged(self.now_s, profile))
        self.send(self.participant_input.make_profile_message())

    def update_visibility(self, visibility: messages.Visibility) -> bool:
        """Store the visibility of the scene. Returns whether the participant has just stopped seeing it.

        If visibility was lost, the next trial starts only after the participant presses the trigger again.
        """
        before, self.visibility = self.visibility, visibility
        if visibility != "visible":
            self.ready_trial_index = -1
            return visibility != before
        if before != "visible":
            self.record_event("visibility_found", "")
            self.event_sink.report(events.VisibilityFound(self.now_s))
        return False

    def reset_location(self) -> None:
        """Delete the participant's position and direction. The next usable frame determines them."""
        self.tracking, self.calibrated_posture = TrackingState(), None

    # Latency of the displayed frames -------------------------------------------------------------------------------

    def record_latency(self, message: messages.Latency) -> schema.Latency | None:
        """Record the client's latencies of the last second, and update the percentiles.

        Returns the latencies; ``None`` if they are incomplete.
        """
        latency = schema.Latency(*(getattr(message, name) for name in schema.Latency.__struct_fields__))
        if not has_all_stages(latency):
            self.report_problem(
                "the latency message is incomplete; it needs one entry per frame for each stage"
            )
            return None
        self._latencies.append(latency)
        self.stage_latencies = [
            messages.StageLatency(stage, **shares)
            for stage, shares in compute_percentiles_ms(self._latencies).items()
        ]
        if self.attempt_storage.attempt is not None:
            self.attempt_storage.attempt.record("/latency", latency, self.now_s)
        return latency

    # Attempts ----------------------------------------------------------------------------------------------------

    def begin_attempt(self) -> None:
        """Start and record an attempt at the current trial. Raises ``OSError`` if it cannot be recorded."""
        assert self.tracking.registration is not None
        plan, trial, world, identifier = self.plan, self.trial_index, self.world, self.session_id
        place = self.tracking.registration.xr_from_world()
        plugins = self.drivers.find_plugins(self.current_trial)
        attempt = self.attempt_storage.begin_attempt(
            trial + 1,
            lambda number: make_attempt_configuration(
                plan,
                trial,
                number,
                world,
                place,
                identifier,
                plugins,
                self.headset_check_result,
                self.participant_input.profile,
            ),
            self.current_trial.num_earlier_attempts + 1,
            self.now_s,
            self.participant_input.profile,
        )
        self.tracking.pop_arrived_frames()
        attempt.record_physics(world, self.now_s)
        self.drivers.clear_failures()
        rules = self.current_trial.rules
        world.prepare_driver(
            self.driver,
            force_guard=plan.has_force_guard,
            withdraw_after_success=self.withdrawal_enabled,
            rules=rules,
        )
        self.head_command_detector = None if rules is None else HeadCommandDetector(rules)
        self._guard_interventions, self._guard_acts, self._withdrew = 0, False, False

    def record_driver_failures(self) -> None:
        """Record when a failure of the driver begins or ends. Reports each kind of failure once per attempt."""
        if isinstance(self.driver, OperatorDriver) and self.driver.is_overdue(self.now_s):
            self.stop_operator(self.driver, "driver_stale")
        failure = self.driver.failure_message
        if failure == self.drivers.latest_failure:
            return
        self.drivers.latest_failure = failure
        self.record_event("controller_failed" if failure else "controller_drives", failure)
        kind = failure.partition(":")[0]
        if kind and kind not in self.drivers.reported_failure_kinds:
            self.drivers.reported_failure_kinds.add(kind)
            self.event_sink.report(events.ControllerFailed(self.now_s, failure))
            self.report_problem(f"the robot holds its position, because its controller failed: {failure}")

    def stop_operator(self, driver: OperatorDriver, event: str) -> None:
        """Stop the robot, because its operator left or sends nothing. ``event``: name of the recorded event."""
        force_n = float(self.world.simulation.get_tool_net_force_n()[0])
        self.record_event(event, f"{driver.active_operator}; contact force of the tool {force_n:.1f} N")
        driver.stop_robot()

    def record_guard_interventions(self) -> None:
        """Record each intervention of the force guard with its reason, and its end."""
        guard = self.world.guard
        if guard is None:
            return
        interventions, acts = int(guard.num_interventions[0]), bool(guard.override_mask[0])
        if interventions > self._guard_interventions:
            self.record_event(INTERVENTION_EVENT, guard.describe_override(0))
        elif self._guard_acts and not acts:
            self.record_event(RELEASE_EVENT, "")
        self._guard_interventions, self._guard_acts = interventions, acts

    def handle_command(self, command: CommandName, source: CommandSource) -> None:
        """Pass a command to the robot, and record it. A command that the trial does not allow is ignored."""
        rules = self.current_trial.rules
        refusal = (
            "this trial has no commands" if rules is None else rules.find_rejection_reason(command, source)
        )
        if refusal:
            self.ignore_command(command, source, refusal)
            return
        self.record_command(command, source, effective=self.world.apply_command(command))

    def record_command(self, command: CommandName, source: CommandSource, *, effective: bool) -> None:
        """Record a command of the participant to the robot."""
        self._record_command(command, source, effective=effective)
        self.event_sink.report(events.RobotCommanded(self.now_s, command, source))

    def ignore_command(self, command: CommandName, source: CommandSource, reason: str) -> None:
        """Record and report why a command is ignored."""
        self._record_command(command, source, refusal=reason)
        self.record_event("command_ignored", f"{command} from {source}: {reason}")
        self.event_sink.report(events.CommandIgnored(self.now_s, command, source, reason))
        self.report_problem(f"the command {command} from {source} is ignored: {reason}")

    def _record_command(
        self, command: CommandName, source: CommandSource, *, effective: bool = False, refusal: str = ""
    ) -> None:
        attempt = self.attempt_storage.attempt
        if attempt is not None:
            record = schema.RobotCommand(command, source, attempt.steps, effective, refusal)
            attempt.record("/robot_commands", record, self.now_s)

    def send_available_commands(self, *, possible: bool) -> None:
        """Send the possible commands and the pacing layer's state, if they have changed."""
        offered = self._offered_commands() if possible else NO_ROBOT_COMMANDS
        if offered != self.available_commands:
            self.available_commands = offered
            self.send(offered)

    def _offered_commands(self) -> messages.AvailableRobotCommands:
        rules, pacing, language = self.current_trial.rules, self.world.pacing, self.plan.texts.language
        if rules is None or pacing is None or not rules.commands:
            return NO_ROBOT_COMMANDS
        labels = [
            messages.CommandLabel(name, ROBOT_COMMANDS[name].localized_label(language))
            for name in rules.commands
        ]
        mode = pacing.get_mode_name(0) if rules.pacing else ""
        return messages.AvailableRobotCommands(
            labels,
            list(rules.sources),
            mode,
            float(pacing.speed_factor[0]),
            float(pacing.preferred_distance_m[0]),
        )

    @property
    def withdrawal_enabled(self) -> bool:
        """Whether the robot withdraws its tool after success. A robot with an operator never withdraws."""
        return self.plan.withdraw_tool_after_success and not isinstance(self.driver, OperatorDriver)

    def record_withdrawal(self) -> None:
        """Record the start of a withdrawal after success."""
        withdraws = self.world.is_withdrawing
        if withdraws and not self._withdrew:
            self.record_event(WITHDRAWAL_EVENT, "")
        self._withdrew = withdraws

    def end_attempt(self, result: AttemptEnd) -> RecordingError | None:
        """End a running attempt. Returns the error that makes its recording incomplete; ``None`` without an error."""
        if self.attempt_storage.attempt is None:
            return None
        failure = self.attempt_storage.end_attempt(result, self.tracking.pop_arrived_frames(), self.now_s)
        self.report_headset_time()
        return failure

    def complete_attempt(self) -> RecordingError | None:
        """Stop the robot after it has finished, and complete a running attempt. Returns an error as ``end_attempt``
        does."""
        self.world.stop_robot()
        return self.end_attempt("completed")

    def abandon_attempt(self, result: AttemptEnd) -> None:
        """Stop the robot, and end a running attempt without completing its trial."""
        self.world.stop_robot()
        if self.attempt_storage.attempt is None:
            return
        self.record_event("robot_holds", result)
        self.attempt_storage.attempt.record_physics(self.world, self.now_s)
        failure = self.end_attempt(result)
        if failure is not None:
            self.report_problem(f"the recording of this attempt is incomplete: {failure}")
