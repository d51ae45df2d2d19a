"""A participant's visit: an open session of a study. The events of its VR session are stored in the database."""

import re
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import asdict, replace
from typing import Self

import msgspec

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Person
from avrgym.policies.registry import find_used_plugins
from avrgym.questionnaires.questionnaire import Item, translate_items
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.recording.schema import Answer, Metrics
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.study.checking.policy_files import POLICIES_USED_EVENT as POLICIES_USED_EVENT
from avrgym.study.checking.policy_files import find_policy_files
from avrgym.study.checking.preflight import load_study_policy
from avrgym.study.people.consents import find_latest_consent
from avrgym.study.people.furniture import read_own_furniture, record_own_furniture
from avrgym.study.people.input_profiles import check_required_participant_arms, set_input_profile
from avrgym.study.people.participants import read_participant_texts, withdraw_participant
from avrgym.study.people.preferences import make_trial_rules, read_latest_preferences, record_preferences
from avrgym.study.sessions.session_threads import SessionMonitor, StorageQueue
from avrgym.study.sessions.stored_session_links import make_language_message
from avrgym.study.storage.answers import (
    AFTER_BREAK_MOMENT,
    change_session_answer,
    change_trial_answer,
    find_attempts_with_open_questionnaire,
    find_items_answered_in_visit,
    record_session_answer,
    record_trial_answer,
    skip_questionnaire,
)
from avrgym.study.storage.attempts import begin_attempt, complete_attempt, end_incomplete_attempt
from avrgym.study.storage.database_rows import StudySession, Trial, TrialAttempt, format_pseudonym
from avrgym.study.storage.free_text import check_single_line
from avrgym.study.storage.remote_recordings import fetch_recordings, upload_recording_before_storage
from avrgym.study.storage.session_summary import compute_earlier_time_in_vr_s
from avrgym.study.storage.sessions import (
    close_session,
    open_session,
    record_session_event,
    skip_trial,
    store_headset_check,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import find_environment
from avrgym.tasks.settings import Settings
from avrgym.texts.interface_texts import InterfaceTexts
from avrgym.vr.protocol.messages import ExperimenterCommand, Language, MessageSender
from avrgym.vr.session import events
from avrgym.vr.session.device_streams import DeviceStreams
from avrgym.vr.session.events import EventObserver, SessionEvent
from avrgym.vr.session.headset_time import HeadsetTime
from avrgym.vr.session.participant_input import ParticipantInput
from avrgym.vr.session.plan import (
    HeadsetCheckPlan,
    OpenQuestionnaire,
    SessionPlan,
    SessionPolicies,
    TrialPlan,
)
from avrgym.vr.session.session import Session
from avrgym.vr.session.world_preparation import ImmediateExecutor

SESSION_END_TIMEOUT_S = 20.0
"""Maximum time in seconds to store the end of a session."""


class StudyVisit:
    """Context manager: an open session of a participant in a study.

    ``stored_session``: the session's row in the database. ``trials``: all trials of the participant in the order of
    ``plan_remaining_trials``: completed trials first.
    """

    def __init__(
        self, store: StudyStore, pseudonym: str, *, take_over: bool = False, storing: Executor | None = None
    ) -> None:
        """Open the participant's next session.

        Args:
            store: the study.
            pseudonym: the participant.
            take_over: end an open session, even if another station may still be running it.
            storing: executor that stores events; default: events are stored immediately in the caller's thread.

        Raises:
            StudyError: if the participant is not allocated, must consent again, or has a running session.
            PolicyError: if a policy of the remaining trials is missing or invalid. No session is opened then.
        """
        self.store, self.pseudonym = store, pseudonym
        self.policies = _policies(store, pseudonym)
        participant = store.read_participant(pseudonym)
        self.texts = read_participant_texts(store, participant)
        self.participant_input = ParticipantInput(participant.input_profile or DEFAULT_INPUT_PROFILE)
        self.stored_session = open_session(store, pseudonym, take_over=take_over)
        self.trials = list_trials_in_order(store, pseudonym)
        self.storage_queue = StorageQueue(storing or ImmediateExecutor())
        self._watch = SessionMonitor(store, self.stored_session.id)
        self.headset_time = HeadsetTime(
            store.design.sessions, compute_earlier_time_in_vr_s(store, self.stored_session)
        )
        self._store_policies()

    @property
    def session_name(self) -> str:
        """Name of the session in messages and recordings, such as ``sub-001 ses-01``."""
        return f"{self.pseudonym} {self.stored_session.name}"

    @property
    def language_message(self) -> Language:
        """The message with the participant's language, and with the texts of the participant's page."""
        return make_language_message(self.texts)

    @property
    def is_ended_elsewhere(self) -> bool:
        """Whether another process has ended the session."""
        return self._watch.is_ended_elsewhere

    def plan_remaining_trials(
        self, furniture: RealFurniture | None = None, *, headset_check: bool = False
    ) -> SessionPlan:
        """Returns the plan of the remaining trials, see ``plan_session``. Raises ``StudyError`` if no trial remains."""
        if not has_unfinished_trials(self.store, self.pseudonym):
            raise StudyError(
                f"{self.pseudonym} has completed all trials; allowed: participants with remaining trials"
            )
        return plan_session(self.store, self.pseudonym, furniture, headset_check=headset_check)

    def create_session(
        self,
        plan: SessionPlan,
        send: MessageSender,
        workers: Executor | None = None,
        scenes: list[tuple[str, Person, Settings]] | None = None,
        streams: DeviceStreams | None = None,
        state_interval_ticks: int = 1,
    ) -> Session:
        """Returns a VR session with a plan. Its events are stored in the database. Arguments: see ``Session``.

        Raises:
            StudyError: if the robot of the first trial has no valid initial state.
        """
        try:
            return Session(
                plan,
                self.policies,
                self.store.resolve_path(self.stored_session.recordings_folder),
                send,
                self.session_name,
                observe=self._observer(),
                is_stored=self.storage_queue.is_done,
                ended_elsewhere=lambda: self.is_ended_elsewhere,
                workers=workers,
                scenes=scenes,
                streams=streams,
                state_interval_ticks=state_interval_ticks,
                participant_input=self.participant_input,
                headset_time=self.headset_time,
            )
        except NoClearanceError as error:
            raise StudyError(
                f"{self.session_name} cannot start: {error}; `avrgym study check` lists bodies without an initial state"
            ) from error

    def _store_policies(self) -> None:
        """Store the current policy files and plug-ins of the remaining trials."""
        files = msgspec.json.encode(find_policy_files(self.store)).decode()
        record_session_event(self.store, self.stored_session.id, POLICIES_USED_EVENT, files)
        used = {each for key, policy in self.policies.items() for each in find_used_plugins(key[0], policy)}
        for each in sorted(used, key=lambda plugin: plugin.label):
            record_session_event(
                self.store, self.stored_session.id, "plug-in used", msgspec.json.encode(each).decode()
            )

    def _observer(self) -> EventObserver:
        store_event = EventRecorder(self.store, self.stored_session, self.trials, self._watch)
        return lambda event: self.storage_queue.submit_checked(lambda: store_event(event))

    def find_unanswered_items(self, when: str) -> tuple[Item, ...]:
        """Returns the unanswered items about the session, in the participant's order and language.

        ``when``: moment, ``before_session`` or ``after_session``.
        """
        asked = self.store.design.list_items_at_moment(when, seed=self.stored_session.participant)
        answered = (
            find_items_answered_in_visit(self.store, self.stored_session) if asked else set[tuple[str, str]]()
        )
        return translate_items([item for item in asked if (when, item.id) not in answered], self.texts)

    def record_answer(self, answer: Answer, when: str) -> Future[None]:
        """Store an answer about the session. Returns a future.

        The future raises ``StudyError`` for an invalid or second answer.
        """
        return self.storage_queue.submit(
            lambda: record_session_answer(self.store, self.stored_session.id, answer, when)
        )

    def change_answer(self, answer: Answer, when: str) -> Future[None]:
        """Store a changed answer about the session. Returns a future; it raises the errors of ``record_answer``."""
        return self.storage_queue.submit(
            lambda: change_session_answer(self.store, self.stored_session.id, answer, when)
        )

    def record_event(self, name: str, detail: str) -> Future[None]:
        """Store an event of the session. Returns a future."""
        return self.storage_queue.submit(
            lambda: record_session_event(self.store, self.stored_session.id, name, detail)
        )

    def change_input_profile(
        self, profile: InputProfile, session: Session | None, now_s: float
    ) -> Future[None]:
        """Change the participant's input profile in this and later sessions. Returns a future for its storage.

        Raises:
            StudyError: if a task of the study works on an absent arm. Nothing changes then.
        """
        check_required_participant_arms(self.store.design, profile)
        if session is None:
            self.participant_input.profile = profile
        else:
            session.change_input_profile(profile, now_s)
        return self.storage_queue.submit(
            lambda: set_input_profile(self.store, self.pseudonym, profile, self.stored_session.id)
        )

    def withdraw_participant(self, session: Session | None, now_s: float, reason: str = "") -> Future[None]:
        """Stop robot and recording, end the VR session, then store the withdrawal. Returns a future.

        Raises:
            StudyError: if the reason is too long or contains control characters. Nothing is stopped then.
        """
        check_single_line("the reason", reason)
        if session is not None and session.phase_name != "finished":
            session.receive(ExperimenterCommand(name="end"), now_s)
        return self.storage_queue.submit(lambda: withdraw_participant(self.store, self.pseudonym, reason))

    def end_session(self) -> Future[None]:
        """Store the end of the session after all other events. Returns a future.

        If no trial and no questionnaire remains, the participant becomes completed.
        """
        self._watch.close()
        return self.storage_queue.submit(self._end)

    def close(self) -> None:
        """End the session, and wait until its end is stored.

        Raises:
            StudyError: if the end cannot be stored. The start of the next session then ends this session.
        """
        try:
            self.end_session().result(SESSION_END_TIMEOUT_S)
        except TimeoutError as error:
            raise StudyError(
                f"the end of {self.stored_session} was not stored because the database is busy; the participant's next "
                "session ends it"
            ) from error

    def _end(self) -> None:
        for attempt in self.store.read_attempts(self.pseudonym):
            if attempt.session == self.stored_session.id and attempt.state == "running":
                upload_recording_before_storage(
                    self.store, attempt.recording, lambda: self.is_ended_elsewhere
                )
        if any(
            row.id == self.stored_session.id and row.state == "open"
            for row in self.store.read_sessions(self.pseudonym)
        ):
            close_session(self.store, self.stored_session.id)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def has_unfinished_trials(store: StudyStore, pseudonym: str) -> bool:
    """Returns whether the participant has a remaining trial or an open questionnaire."""
    return bool(
        store.read_remaining_trials(pseudonym)
        or find_attempts_with_open_questionnaire(store, store.read_attempts(pseudonym))
    )


def list_trials_in_order(store: StudyStore, pseudonym: str) -> list[Trial]:
    """Returns all trials of a participant: first the completed trials, then the remaining trials."""
    remaining = store.read_remaining_trials(pseudonym)
    over = [trial for trial in store.read_trials(pseudonym) if trial not in remaining]
    return over + remaining


def plan_session(
    store: StudyStore, pseudonym: str, furniture: RealFurniture | None = None, *, headset_check: bool = False
) -> SessionPlan:
    """Returns the plan of a participant's next session. A trial or an open questionnaire must remain.

    ``furniture``: the real seat and bed; default: the participant's own, or the design's. ``headset_check``: check the
    headset even if the design does not require it. Simulated participants have no headset check.
    """
    participant, design = store.read_participant(pseudonym), store.design
    texts = read_participant_texts(store, participant)
    checked = headset_check or design.headset_check
    trials = list_trials_in_order(store, pseudonym)
    made = [attempt.trial for attempt in store.read_attempts(pseudonym)]
    own = read_latest_preferences(store, pseudonym) if design.conditions else None
    return SessionPlan(
        [
            replace(
                _trial_plan(store, trial, made.count(trial.id), texts),
                rules=make_trial_rules(store, trial.policy, own),
                allow_preference_changes=trial.policy in design.conditions
                and design.conditions[trial.policy].preferences,
            )
            for trial in trials
        ],
        participant.sex,
        design.free_movement_s,
        is_simulated=participant.simulated,
        questionnaire_items=translate_items(design.list_items_at_moment("after_trial"), texts),
        trial_steps=design.trial_steps,
        furniture=furniture or read_own_furniture(store, pseudonym) or design.furniture,
        has_force_guard=design.force_guard,
        withdraw_tool_after_success=design.withdraw_after_success,
        stop_rules=design.stop_rule_set,
        texts=texts,
        reach_measurement_enabled=design.measure_reach and not participant.simulated,
        headset_check=HeadsetCheckPlan() if checked and not participant.simulated else None,
        first_trial_number=len(trials) - len(store.read_remaining_trials(pseudonym)) + 1,
        open_questionnaire=_open_questionnaire(store, pseudonym, trials),
        consent=find_latest_consent(store.read_consents(pseudonym)),
        proxy_consent=find_latest_consent(store.read_consents(pseudonym), of_proxy=True),
        respondent=participant.effective_respondent,
        settings=design.settings,
        allow_other_settings=design.allow_other_settings,
        session_rules=design.sessions,
        break_items=translate_items(
            design.list_items_at_moment(AFTER_BREAK_MOMENT, participant.number), texts
        ),
    )


def _open_questionnaire(
    store: StudyStore, pseudonym: str, trials: Sequence[Trial]
) -> OpenQuestionnaire | None:
    """Returns the first open questionnaire, which is shown before the next trial; ``None`` if there is none."""
    left = find_attempts_with_open_questionnaire(store, store.read_attempts(pseudonym))
    if not left:
        return None
    attempt = left[0]
    if store.is_temporary:
        fetch_recordings(store, pseudonym)
    number = next(i for i, trial in enumerate(trials, 1) if trial.id == attempt.trial)
    given = {each.item: each.value for each in store.read_answers(pseudonym) if each.attempt == attempt.id}
    return OpenQuestionnaire(number, attempt.number, store.resolve_path(attempt.recording), given)


def _trial_plan(store: StudyStore, trial: Trial, attempts: int, texts: InterfaceTexts) -> TrialPlan:
    return TrialPlan(
        trial.environment,
        trial.policy,
        trial.seed,
        trial.practice,
        goal_description=texts.translate(store.design.goals.get(find_environment(trial.environment)[0], "")),
        questionnaire_items=translate_items(
            store.design.list_items_at_moment("after_trial", trial.seed), texts
        ),
        num_earlier_attempts=attempts,
        settings=store.design.find_condition_settings(trial.policy),
    )


def _policies(store: StudyStore, pseudonym: str) -> SessionPolicies:
    """Returns the policies of all trials that are not completed or have an open questionnaire.

    After a crash, a trial can still have the state ``running``.
    """
    left = {
        attempt.trial
        for attempt in find_attempts_with_open_questionnaire(store, store.read_attempts(pseudonym))
    }
    wanted = {
        (each.environment, each.policy)
        for each in store.read_trials(pseudonym)
        if each.state != "completed" or each.id in left
    }
    return {
        (environment, policy): load_study_policy(store, environment, policy) for environment, policy in wanted
    }


class EventRecorder:
    """Stores the events of a VR session until another process ends the session. Storage errors are raised."""

    def __init__(
        self, store: StudyStore, session: StudySession, trials: Sequence[Trial], watch: SessionMonitor
    ) -> None:
        """``trials``: in the order of the session's plan. ``watch``: monitor of the session."""
        self._store, self._session, self._trials, self._watch = store, session, trials, watch
        self._pseudonym = format_pseudonym(session.participant)
        self._attempt: TrialAttempt | None = None
        self._began_s = 0.0
        self._torso_height_m: float | None = None

    def __call__(self, event: SessionEvent) -> None:
        """Store an event. It is on disk when this method returns."""
        if self._watch.is_ended_elsewhere:
            return
        match event:
            case events.TrialBegun():
                self._begin(event)
            case events.AnswerChanged():
                change_trial_answer(self._store, self._answered(event.trial), event.answer)
            case events.HeadsetChecked():
                store_headset_check(self._store, self._session.id, event.check)
            case events.Answered():
                record_trial_answer(self._store, self._answered(event.trial), event.answer)
            case events.QuestionsLeft():
                skip_questionnaire(self._store, self._answered(event.trial), event.items)
            case events.TrialEnded():
                self._end(event)
            case events.TrialSkipped():
                self._skip(event)
            case events.Calibrated() | events.TorsoHeightCorrected():
                self._torso_height_m = event.torso_height_m
                self._record_event(event)
            case events.AnsweredAfterBreak():
                record_session_answer(self._store, self._session.id, event.answer, AFTER_BREAK_MOMENT)
            case events.FurnitureMeasured():
                record_own_furniture(self._store, self._pseudonym, event.furniture)
                self._record_event(event)
            case events.PreferencesChanged():
                record_preferences(self._store, self._pseudonym, event.preferences)
                self._record_event(event)
            case events.InputChanged():
                pass  # ``StudyVisit.change_input_profile`` stores it
            case _:
                self._record_event(event)

    def _begin(self, begun: events.TrialBegun) -> None:
        self._settle()
        position = self._trials[begun.trial - 1].position
        self._attempt = begin_attempt(
            self._store,
            self._session.id,
            position,
            begun.recording,
            torso_height_m=self._torso_height_m,
            input_profile=begun.input_profile,
        )
        self._began_s = begun.time_s

    def _settle(self) -> None:
        """Store the state ``failed`` for an attempt that still runs because its end could not be stored."""
        for attempt in self._store.read_attempts(self._pseudonym):
            if self._attempt is not None and attempt.id == self._attempt.id and attempt.state == "running":
                end_incomplete_attempt(self._store, attempt.id, "failed")
        self._attempt = None

    def _end(self, ended: events.TrialEnded) -> None:
        if self._attempt is None:
            return
        self._upload(self._attempt)
        seconds = ended.time_s - self._began_s
        metrics = Metrics(ended.steps, ended.reward, ended.success, seconds)
        if ended.result == "completed":
            complete_attempt(self._store, self._attempt.id, metrics)
        else:
            end_incomplete_attempt(self._store, self._attempt.id, ended.result, metrics)
        self._attempt = None

    def _skip(self, skipped: events.TrialSkipped) -> None:
        """Move a trial to the end of the remaining trials. A trial that was skipped before is not moved."""
        position = self._trials[skipped.trial - 1].position
        if self._store.read_trials(self._pseudonym)[position - 1].state == "planned":
            skip_trial(self._store, self._session.id, position)

    def _record_event(self, event: SessionEvent) -> None:
        details = {name: value for name, value in asdict(event).items() if name != "time_s"}
        name = re.sub(r"(?<!^)(?=[A-Z])", " ", type(event).__name__).lower()
        detail = ", ".join(f"{key} {value}" for key, value in details.items())
        attempt = self._attempt.id if self._attempt is not None else None
        record_session_event(self._store, self._session.id, name, detail, attempt)

    def _upload(self, attempt: TrialAttempt) -> None:
        upload_recording_before_storage(
            self._store, attempt.recording, lambda: self._watch.is_ended_elsewhere
        )

    def _answered(self, number: int) -> int:
        """Returns the id of the running attempt, or else of the attempt that completed the trial with this number."""
        if self._attempt is not None:
            return self._attempt.id
        trial = self._trials[number - 1]
        for attempt in self._store.read_attempts(self._pseudonym):
            if attempt.trial == trial.id and attempt.state == "completed":
                self._upload(attempt)
                return attempt.id
        raise StudyError(f"trial {number} has no completed attempt; allowed: answers about completed trials")
