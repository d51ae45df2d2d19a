"""The session of one participant: a state machine with phases from calibration to the questionnaires.

The package ``phases`` defines texts and transitions. The module ``state`` contains the data that all phases share.

The session has no clock and no network. The caller passes messages and ticks, with the time in seconds since the
session's start. The caller also sends the session's messages to the clients. The same code therefore runs in real time
and, with a simulated participant, faster than real time.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from pathlib import Path

from avrgym.models import human
from avrgym.models.body_names import PERSON_ARM_SIDES, TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.models.human import Person
from avrgym.questionnaires.stop_rules import StopDecision
from avrgym.recording.input_profile import InputProfile
from avrgym.tasks.control_loop import FirstWorldStep
from avrgym.tasks.settings import Settings
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import MessageSender, PhaseName, ReceivedMessage
from avrgym.vr.protocol.webxr import Registration
from avrgym.vr.session import events
from avrgym.vr.session.attempt import Attempt, AttemptResults, read_package_versions
from avrgym.vr.session.attempt_storage import AttemptStorage, QuestionnaireAttempt
from avrgym.vr.session.device_streams import DeviceStreams, StreamRecorder
from avrgym.vr.session.dispatch import handle_message
from avrgym.vr.session.events import EventObserver, EventSink
from avrgym.vr.session.headset_time import HeadsetTime
from avrgym.vr.session.interruptions import make_suspension_interruption, make_tracking_interruption
from avrgym.vr.session.participant_input import ParticipantInput
from avrgym.vr.session.phases import Phase, TrialQuestionnaire, WaitingForParticipant
from avrgym.vr.session.plan import OpenQuestionnaire, SessionPlan, SessionPolicies
from avrgym.vr.session.questions import QuestionSequence
from avrgym.vr.session.reporting import StateReporter, make_status
from avrgym.vr.session.session_state import SessionState
from avrgym.vr.session.trial_drivers import TrialDrivers
from avrgym.vr.session.trial_worlds import TrialWorlds
from avrgym.vr.session.world_preparation import ImmediateExecutor

MAX_TICK_GAP_S = 0.5
"""Maximum time in seconds between two ticks, usually 10 ms. A longer gap ends an attempt."""


class Session:
    """The session of one participant. Passes messages and ticks to the current phase, and enters the next phase."""

    def __init__(
        self,
        plan: SessionPlan,
        policies: SessionPolicies,
        folder: Path,
        send: MessageSender,
        identifier: str,
        *,
        observe: events.EventObserver = lambda event: None,
        is_stored: Callable[[], bool] = lambda: True,
        ended_elsewhere: Callable[[], bool] = lambda: False,
        workers: Executor | None = None,
        scenes: list[tuple[str, Person, Settings]] | None = None,
        streams: DeviceStreams | None = None,
        state_interval_ticks: int = 1,
        participant_input: ParticipantInput | None = None,
        headset_time: HeadsetTime | None = None,
    ) -> None:
        """Start in the phase ``waiting``, with a person of reference height.

        Args:
            plan: the trials and settings of the session.
            policies: all policies of the plan.
            folder: the folder of recordings; files are never overwritten.
            send: called with every message for the clients.
            identifier: the session's name for clients and recordings.
            observe: called with every event. If it raises an error, the session pauses.
            is_stored: returns whether the observer has stored all events. Until then no phase times out, and no trial
                follows a completed trial. If it raises an error, the session pauses.
            ended_elsewhere: returns whether another process has ended the session; called at every tick.
            workers: an executor that builds the worlds of later trials. Without it, the thread that calls ``tick``
                builds them, and waits for external controllers.
            scenes: scenes of earlier sessions. Their addresses remain valid. The session adds its own scenes.
            streams: the streams of other devices, for sessions in real time.
            state_interval_ticks: interval between two sent states of the world, in ticks.
            participant_input: the participant's input profile and its changes; default: created from the plan.
            headset_time: counts the participant's time in VR; default: starts at 0, with the plan's rules.
        """
        left = plan.open_questionnaire
        trial = (plan.first_trial_number if left is None else left.trial_number) - 1
        participant_input = participant_input or ParticipantInput(plan.input_profile)
        absent_arms = participant_input.profile.absent_arms
        person = Person(plan.sex, human.BODY_DIMENSIONS[plan.sex].torso_height_m, absent_arms=absent_arms)
        worlds = TrialWorlds(
            plan, trial, person, workers or ImmediateExecutor(), [] if scenes is None else scenes
        )
        sink = EventSink(observe if streams is None else _both(streams.send_event, observe), is_stored)
        storage = AttemptStorage(folder, sink)
        drivers = TrialDrivers(policies, background=workers is not None)
        read_package_versions()  # this reads files the first time, which must not delay a tick
        self._state = SessionState(
            plan, drivers, identifier, send, sink, storage, worlds, trial, person, participant_input,
            headset_time or HeadsetTime(plan.session_rules),
        )  # fmt: skip
        self._ended_elsewhere = ended_elsewhere
        self._streams = None if streams is None else StreamRecorder(streams, self._state)
        self._reporter = StateReporter(send, state_interval_ticks)
        self._ticked_s: float | None = None
        self._enter(WaitingForParticipant(self._state) if left is None else self._reopened(left))

    @property
    def phase_name(self) -> PhaseName:
        """The name of the current phase."""
        return self._phase.name

    @property
    def is_at_rest(self) -> bool:
        """Whether neither the participant nor the robot moves. A delay of some milliseconds is then acceptable."""
        return not self._phase.has_motion

    @property
    def plan(self) -> SessionPlan:
        """The trials and settings of the session."""
        return self._state.plan

    @property
    def trial_index(self) -> int:
        """The index of the running or next trial of the plan. After the last trial, this is the number of trials."""
        return self._state.trial_index

    @property
    def person(self) -> Person:
        """The participant's body model, with its current joint angles."""
        return self._state.person

    @property
    def attempt(self) -> Attempt | None:
        """The running attempt; ``None`` between attempts."""
        return self._state.attempt_storage.attempt

    @property
    def recordings(self) -> list[Path]:
        """The recording files of all attempts of this session."""
        return self._state.attempt_storage.recordings

    @property
    def attempt_results(self) -> AttemptResults:
        """Success, force and tool speed of the latest attempt until now."""
        return self._state.attempt_storage.attempt_results

    @property
    def scenes(self) -> list[tuple[str, Person, Settings]]:
        """(environment, person, settings) of each scene that clients may load. A scene's address contains its index."""
        return self._state.trial_worlds.scenes

    @property
    def registration(self) -> Registration | None:
        """The pose of the participant's floor in the world frame; ``None`` before calibration."""
        return self._state.tracking.registration

    @property
    def world(self) -> LiveWorld:
        """The world that the clients show now."""
        return self._state.world

    @property
    def bodies(self) -> tuple[str, ...]:
        """The names of the bodies, in the order of the poses in every state."""
        return self.world.bodies

    def send_initial_state(self, send: MessageSender, role: messages.Role, now_s: float) -> None:
        """Send the state of the session to a client that has just connected."""
        state = self._state
        if role == "participant":
            state.trial_worlds.reset_shown_scene()
            state.visibility = "visible"
            state.event_sink.report(events.ConnectionFound(now_s))
        plan = state.plan
        how = {"haptics": plan.haptics, "sounds": plan.sounds}
        send(messages.Welcome(messages.PROTOCOL_VERSION, state.session_id, role, **how))
        send(state.make_language_message())
        send(state.make_body_message())
        state.participant_input.send_initial_state(send, role)
        send(state.make_scene_message())
        state.send_world_motion(send)
        if state.available_commands.commands:
            send(state.available_commands)
        self._announce(send)

    def receive(self, message: ReceivedMessage, now_s: float) -> None:
        """Handle a message from a client of the session."""
        self._state.now_s = now_s
        self._go_to(handle_message(self._phase, message))

    def change_input_profile(self, profile: InputProfile, now_s: float) -> None:
        """Change the participant's input profile: the methods to select and to stop."""
        self._state.now_s = now_s
        self._state.change_input_profile(profile)

    def tick(self, now_s: float) -> None:
        """Advance the world by 10 ms of simulated time and the session to ``now_s``."""
        state, storage = self._state, self._state.attempt_storage
        before_s, self._ticked_s = self._ticked_s, now_s
        state.now_s = now_s
        state.count_headset_time(0.0 if before_s is None else now_s - before_s)
        if self._ended_elsewhere() or self._is_over():
            self._go_to(self._phase.cancel_session())
        if storage.attempt is not None:
            self._check_continuity(0.0 if before_s is None else now_s - before_s)
        self._follow()
        driver = self._phase.driver
        step = self.world.tick(driver, hold=bool(state.tracking.untracked_needed_parts))
        if storage.attempt is not None:
            storage.attempt.record_physics(self.world, now_s)
        if driver is not None:
            state.record_driver_failures()
            state.record_guard_interventions()
            state.record_withdrawal()
        if step is not None:
            self._go_to(self._phase.on_control_step(step))
        state.send_available_commands(possible=self._phase.name == "trial")
        self._check_storage()
        while self._go_to(self._phase.poll()):
            pass
        self._report(step)
        if self._streams is not None:
            self._streams.tick()
        if self._ends_at is not None and now_s >= self._ends_at and state.event_sink.has_stored_all_events():
            self._go_to(self._phase.on_timeout())
        if storage.attempt is not None:
            storage.attempt.submit_records()

    def wait_for_writes(self) -> None:
        """Wait until most records are written. Sessions that run faster than real time need this."""
        if self.attempt is not None:
            self.attempt.wait_for_writes()

    def close(self, now_s: float) -> None:
        """End the session. A running trial is stored as interrupted, or as completed if the robot has finished."""
        self._state.now_s = now_s
        if self._phase.robot_finished:
            self._state.complete_attempt()
        self._state.abandon_attempt("interrupted")
        self._state.drivers.close()

    def prevent_trials(self, decision: StopDecision) -> None:
        """Prevent further trials, because an answer before the session met a stop rule."""
        self._state.prevent_trials(decision)

    def _is_over(self) -> bool:
        """Returns whether a stop rule ends the session, and the last trial is stored."""
        storage = self._state.attempt_storage
        idle = (
            storage.attempt is None
            and storage.unstored_trial_index is None
            and not self._phase.robot_finished
        )
        return self._state.is_ended_by_stop_rule and idle

    def _reopened(self, left: OpenQuestionnaire) -> TrialQuestionnaire:
        """Returns the phase that presents the open questionnaire of an earlier session."""
        state = self._state
        state.attempt_storage.questionnaire_attempt = QuestionnaireAttempt(
            left.trial_number, left.attempt_number, left.recording
        )
        return TrialQuestionnaire(
            state,
            QuestionSequence(state.plan.find_questionnaire_items(state.current_trial), left.existing_answers),
        )

    def _go_to(self, phase: Phase) -> bool:
        """Enter a phase, unless it is the current phase. Returns whether the phase has changed."""
        if phase is self._phase:
            return False
        self._enter(phase)
        return True

    def _enter(self, phase: Phase) -> None:
        state, trials = self._state, len(self._state.plan.trials)
        trial, texts = min(state.trial_index + 1, trials), state.plan.texts
        self._phase = phase
        self._ends_at = None if phase.time_limit_s is None else state.now_s + phase.time_limit_s
        self._message = messages.PhaseDescription(
            phase.name,
            texts.format_for_vr(phase.message),
            trial,
            trials,
            state.current_trial.practice,
            phase.time_limit_s,
            texts.format_for_page(phase.message),
            texts.format_by_select_input(phase.message),
            phase.message.text_key,
            phase.can_change_preferences,
        )
        state.record_event("phase", phase.name)
        state.event_sink.report(events.PhaseEntered(state.now_s, phase.name, trial))
        self._announce(state.send)
        phase.on_enter()

    def _announce(self, send: MessageSender) -> None:
        send(self._message)
        if self._phase.question is not None:
            send(self._phase.question)

    def _follow(self) -> None:
        """Move the simulated person to the pose in the newest tracking frame. A stale frame does not move them."""
        state, attempt = self._state, self._state.attempt_storage.attempt
        profile = state.participant_input.profile
        followed = state.tracking.update(state.needed_body_parts, state.now_s, profile)
        if followed.target_pose is not None:
            self.world.follow_pose(
                followed.target_pose, [arm for arm in PERSON_ARM_SIDES if arm not in profile.tracked_arms]
            )
        if self._phase.participant_located:
            state.move_seat()
        for part in filter(profile.needs_tracking, TRACKED_BODY_PARTS):
            if (part in followed.untracked_needed_parts) != (
                part in followed.previous_untracked_needed_parts
            ):
                self._report_tracking(part, lost=part in followed.untracked_needed_parts)
            if (part in followed.deviating_parts) != (part in followed.previous_deviating_parts):
                state.record_event("pose_held" if part in followed.deviating_parts else "pose_followed", part)
        if attempt is None:
            return
        attempt.record_frames(followed)
        attempt.record_joint_targets(self.world.joint_targets_rad, state.now_s)

    def _report_tracking(self, part: TrackedBodyPart, *, lost: bool) -> None:
        """Report that tracking of a needed part of the body is lost, or has returned."""
        state = self._state
        state.record_event("tracking_lost" if lost else "tracking_found", part)
        kind = events.TrackingLost if lost else events.TrackingFound
        state.event_sink.report(kind(state.now_s, part))

    def _check_continuity(self, since_last_tick_s: float) -> None:
        """Interrupt an attempt if a part of the body was untracked for too long, or the process was suspended."""
        if since_last_tick_s > MAX_TICK_GAP_S:
            self._go_to(
                self._phase.interrupt(make_suspension_interruption(self._state.now_s, since_last_tick_s))
            )
        elif self._phase.can_be_stopped and self._state.untracked_part is not None:
            self._go_to(
                self._phase.interrupt(
                    make_tracking_interruption(self._state.now_s, self._state.untracked_part)
                )
            )

    def _check_storage(self) -> None:
        """Report a slow disk. If a trial cannot be recorded or stored, stop the robot and end the attempt."""
        state, storage = self._state, self._state.attempt_storage
        stored, failure = state.event_sink.has_stored_all_events(), storage.pop_failure()
        if failure is not None:
            self._go_to(self._phase.on_storage_failure(failure))
        elif stored and storage.unstored_trial_index is not None:
            state.trial_index = max(state.trial_index, storage.unstored_trial_index + 1)
            storage.unstored_trial_index = None
            self._go_to(self._phase.on_trial_stored())
        if storage.attempt is None:
            return
        stall, failure = storage.attempt.pop_slow_disk_error(), storage.attempt.recording_error
        if stall is not None:
            state.record_event("recording_stalled", str(stall))
            state.report_problem(f"the disk is slow, but the recording continues: {stall}")
        if failure is not None:
            self._go_to(self._phase.on_storage_failure(failure))

    def _report(self, step: FirstWorldStep | None) -> None:
        state = self._state
        self._reporter.tick(self.world, state.tracking, step)
        if self._reporter.is_status_due:
            standing = self._message, self.attempt, self.world, state.tracking, state.now_s
            steps, paused, why = state.plan.trial_steps, state.is_paused, state.pause_reason
            driver, latency = state.driver, state.stage_latencies
            streams = [] if self._streams is None else self._streams.stream_statuses
            how = make_status(
                *standing,
                steps=steps,
                paused=paused,
                why=why,
                driver=driver,
                latency=latency,
                streams=streams,
                visibility=state.visibility,
                profile=state.participant_input.profile,
                headset_time=state.headset_time,
            )
            state.send(how)


def _both(first: EventObserver, second: EventObserver) -> EventObserver:
    def observe(event: events.SessionEvent) -> None:
        first(event)
        second(event)

    return observe
