"""A participant's visit: their session in VR on the study's store. Each fact is stored before the session goes on."""

import re
from collections.abc import Sequence
from concurrent.futures import Executor, Future
from dataclasses import asdict
from typing import Self

import msgspec

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Person
from avrgym.policies.registry import plugins_used
from avrgym.questionnaires.questionnaire import Item, translate
from avrgym.recording.schema import Answer, Metrics
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.study.checking.policy_files import POLICIES_USED as POLICIES_USED
from avrgym.study.checking.policy_files import policy_files
from avrgym.study.checking.preflight import load_study_policy
from avrgym.study.people.consents import latest_consent
from avrgym.study.people.participants import participant_texts, withdraw
from avrgym.study.sessions.links import language_message
from avrgym.study.sessions.threads import SessionWatch, StorageQueue
from avrgym.study.storage.answers import (
    answered_in_visit,
    attempts_with_open_questionnaire,
    change_answer,
    change_session_answer,
    record_answer,
    record_session_answer,
    skip_questionnaire,
)
from avrgym.study.storage.attempts import begin_attempt, complete_attempt, end_attempt
from avrgym.study.storage.free_text import check_line
from avrgym.study.storage.rows import StudySession, Trial, TrialAttempt, pseudonym_of
from avrgym.study.storage.sessions import (
    close_session,
    open_session,
    record_session_event,
    skip_trial,
    store_headset_check,
)
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.tasks.registry import find_environment
from avrgym.texts.interface_texts import Texts
from avrgym.vr.protocol.messages import Command, Language, Send
from avrgym.vr.session import events
from avrgym.vr.session.events import Observer, SessionEvent
from avrgym.vr.session.plan import HeadsetCheckPlan, OpenQuestionnaire, Policies, SessionPlan, TrialPlan
from avrgym.vr.session.preparation import AtOnce
from avrgym.vr.session.session import Session
from avrgym.vr.session.streams import Streams

STORE_TIMEOUT_S = 20.0
"""How long the end of a session may take to be stored."""


class StudyVisit:
    """An open session of a participant in a study, as a context manager.

    ``stored`` is its row, ``trials`` are all of the participant's trials in the order of ``plan``: completed ones,
    behind which the session begins, then those that remain.
    """

    def __init__(
        self, store: Store, pseudonym: str, *, take_over: bool = False, storing: Executor | None = None
    ) -> None:
        """Open the participant's session, or the next one after a break or a crash.

        Args:
            store: the study.
            pseudonym: the participant.
            take_over: also end a session that may still run elsewhere.
            storing: one thread that stores what happens, so that a session in real time never waits for the database;
                without it each fact is stored before the session goes on.

        Raises:
            StudyError: without consent and an allocated order, or while another session runs.
            PolicyError: when a policy of the remaining trials is missing or does not fit; no session is opened.
        """
        self.store, self.pseudonym = store, pseudonym
        self.policies = _policies(store, pseudonym)
        self.texts = participant_texts(store, store.participant(pseudonym))
        self.stored = open_session(store, pseudonym, take_over=take_over)
        self.trials = trials_in_order(store, pseudonym)
        self.storing = StorageQueue(storing or AtOnce())
        self._watch = SessionWatch(store, self.stored.id)
        self._store_policies()

    @property
    def identifier(self) -> str:
        """The name of the session for clients and recordings."""
        return f"{self.pseudonym} {self.stored.name}"

    @property
    def language_message(self) -> Language:
        """The participant's language, with the words of their page."""
        return language_message(self.texts)

    @property
    def called_off(self) -> bool:
        """Whether somebody elsewhere has ended the session."""
        return self._watch.called_off

    def plan(self, furniture: RealFurniture | None = None, *, headset_check: bool = False) -> SessionPlan:
        """What remains to be run; ``StudyError`` when nothing does, as after a crash at the very end.

        The arguments are those of ``plan_session``.
        """
        if not has_remaining(self.store, self.pseudonym):
            raise StudyError(f"{self.pseudonym} has completed every trial")
        return plan_session(self.store, self.pseudonym, furniture, headset_check=headset_check)

    def session(
        self,
        plan: SessionPlan,
        send: Send,
        workers: Executor | None = None,
        scenes: list[tuple[str, Person]] | None = None,
        streams: Streams | None = None,
        state_every_ticks: int = 1,
    ) -> Session:
        """A session in VR that runs the visit's plan or the first trials of it, and is stored as it happens.

        The arguments are those of ``Session``.

        Raises:
            StudyError: where the robot of the first trial has no room to begin.
        """
        try:
            return Session(
                plan,
                self.policies,
                self.store.path(self.stored.folder),
                send,
                self.identifier,
                observe=self._observer(),
                kept=self.storing.done,
                called_off=lambda: self.called_off,
                workers=workers,
                scenes=scenes,
                streams=streams,
                state_every_ticks=state_every_ticks,
            )
        except NoClearanceError as error:
            raise StudyError(
                f"{self.identifier} cannot begin: {error}; `avrgym study check` lists who has no start"
            ) from error

    def _store_policies(self) -> None:
        """Store the files of the policies and which plug-ins the remaining trials use, as these are now."""
        files = msgspec.json.encode(policy_files(self.store)).decode()
        record_session_event(self.store, self.stored.id, POLICIES_USED, files)
        used = {each for key, policy in self.policies.items() for each in plugins_used(key[0], policy)}
        for each in sorted(used, key=lambda plugin: plugin.label):
            record_session_event(
                self.store, self.stored.id, "plug-in used", msgspec.json.encode(each).decode()
            )

    def _observer(self) -> Observer:
        keeper = EventStorage(self.store, self.stored, self.trials, self._watch)
        return lambda happened: self.storing.ask(lambda: keeper(happened))

    def items(self, when: str) -> tuple[Item, ...]:
        """What is still to be asked ``before_session`` or ``after_session``, in this participant's order and language.

        What was answered before a crash is not asked again.
        """
        asked = self.store.design.items_at(when, seed=self.stored.participant)
        answered = answered_in_visit(self.store, self.stored) if asked else set[tuple[str, str]]()
        return translate([item for item in asked if (when, item.id) not in answered], self.texts)

    def record(self, answer: Answer, when: str) -> Future[None]:
        """Store an answer about the session; the future raises ``StudyError`` for what is none or was given already."""
        return self.storing.submit(lambda: record_session_answer(self.store, self.stored.id, answer, when))

    def change(self, answer: Answer, when: str) -> Future[None]:
        """Store an answer about the session in the place of an earlier one; as ``record``."""
        return self.storing.submit(lambda: change_session_answer(self.store, self.stored.id, answer, when))

    def tell(self, name: str, detail: str) -> Future[None]:
        """Store that something happened; the future tells when that is done."""
        return self.storing.submit(lambda: record_session_event(self.store, self.stored.id, name, detail))

    def withdraw(self, session: Session | None, now_s: float, reason: str = "") -> Future[None]:
        """Stop robot and recording, end the session in VR if there is one, then store that the participant withdrew.

        The future tells when that is stored. ``StudyError`` for a reason that is too long; nothing is stopped then.
        """
        check_line("the reason", reason)
        if session is not None and session.phase != "finished":
            session.receive(Command(name="end"), now_s)
        return self.storing.submit(lambda: withdraw(self.store, self.pseudonym, reason))

    def end(self) -> Future[None]:
        """Store after all else that the session has ended, unless that is stored; the future tells when it is.

        After the last trial the participant has completed the study.
        """
        self._watch.close()
        return self.storing.submit(self._end)

    def close(self) -> None:
        """End the session, and wait until that is stored.

        Raises:
            StudyError: when it cannot be; the next session of the participant then ends this one.
        """
        try:
            self.end().result(STORE_TIMEOUT_S)
        except TimeoutError as error:
            raise StudyError(f"{self.stored}: its end is not stored, the database is busy") from error

    def _end(self) -> None:
        if any(
            row.id == self.stored.id and row.state == "open" for row in self.store.sessions(self.pseudonym)
        ):
            close_session(self.store, self.stored.id)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def has_remaining(store: Store, pseudonym: str) -> bool:
    """Whether a participant has trials to run, or a questionnaire of one to answer."""
    return bool(
        store.remaining_trials(pseudonym)
        or attempts_with_open_questionnaire(store, store.attempts(pseudonym))
    )


def trials_in_order(store: Store, pseudonym: str) -> list[Trial]:
    """All of a participant's trials: those that a session has no more to run, then those that remain."""
    remaining = store.remaining_trials(pseudonym)
    over = [trial for trial in store.trials(pseudonym) if trial not in remaining]
    return over + remaining


def plan_session(
    store: Store, pseudonym: str, furniture: RealFurniture | None = None, *, headset_check: bool = False
) -> SessionPlan:
    """What a session of a participant runs now; there must be a trial or an open questionnaire that remains.

    ``furniture`` is what the participant really sits and lies on, the design's unless given. ``headset_check``: the
    headset of a person is checked also where the design does not say so.
    """
    participant, design = store.participant(pseudonym), store.design
    texts = participant_texts(store, participant)
    checked = headset_check or design.headset_check
    trials = trials_in_order(store, pseudonym)
    made = [attempt.trial for attempt in store.attempts(pseudonym)]
    return SessionPlan(
        [_trial_plan(store, trial, made.count(trial.id), texts) for trial in trials],
        participant.sex,
        design.free_movement_s,
        simulated=participant.simulated,
        items=translate(design.items_at("after_trial"), texts),
        trial_steps=design.trial_steps,
        furniture=furniture or design.furniture,
        force_guard=design.force_guard,
        withdraw_after_success=design.withdraw_after_success,
        stop_rules=design.rules,
        texts=texts,
        measure_reach=design.measure_reach and not participant.simulated,
        headset_check=HeadsetCheckPlan() if checked and not participant.simulated else None,
        first_trial=len(trials) - len(store.remaining_trials(pseudonym)) + 1,
        open_questionnaire=_open_questionnaire(store, pseudonym, trials),
        consent=latest_consent(store.consents(pseudonym)),
    )


def _open_questionnaire(store: Store, pseudonym: str, trials: Sequence[Trial]) -> OpenQuestionnaire | None:
    """The first that is to be asked before another trial begins."""
    left = attempts_with_open_questionnaire(store, store.attempts(pseudonym))
    if not left:
        return None
    attempt = left[0]
    number = next(i for i, trial in enumerate(trials, 1) if trial.id == attempt.trial)
    given = {each.item: each.value for each in store.answers(pseudonym) if each.attempt == attempt.id}
    return OpenQuestionnaire(number, attempt.number, store.path(attempt.recording), given)


def _trial_plan(store: Store, trial: Trial, attempts: int, texts: Texts) -> TrialPlan:
    return TrialPlan(
        trial.environment,
        trial.policy,
        trial.seed,
        trial.practice,
        goal=texts.translate(store.design.goals.get(find_environment(trial.environment)[0], "")),
        items=translate(store.design.items_at("after_trial", trial.seed), texts),
        earlier_attempts=attempts,
    )


def _policies(store: Store, pseudonym: str) -> Policies:
    """The policies of trials that are not completed, or whose questionnaire is open.

    A trial may still count as running that a crash broke off.
    """
    left = {attempt.trial for attempt in attempts_with_open_questionnaire(store, store.attempts(pseudonym))}
    wanted = {
        (each.environment, each.policy)
        for each in store.trials(pseudonym)
        if each.state != "completed" or each.id in left
    }
    return {
        (environment, policy): load_study_policy(store, environment, policy) for environment, policy in wanted
    }


class EventStorage:
    """Stores what happens in a session in VR, unless it was called off; raises what keeps it from doing so."""

    def __init__(
        self, store: Store, session: StudySession, trials: Sequence[Trial], watch: SessionWatch
    ) -> None:
        """Keep a session's events; ``trials`` stand in the order of its plan."""
        self._store, self._session, self._trials, self._watch = store, session, trials, watch
        self._pseudonym = pseudonym_of(session.participant)
        self._attempt: TrialAttempt | None = None
        self._began_s = 0.0
        self._torso_height_m: float | None = None

    def __call__(self, happened: SessionEvent) -> None:
        """Store an event; on return it is on disk."""
        if self._watch.called_off:
            return
        match happened:
            case events.TrialBegun():
                self._begin(happened)
            case events.AnswerChanged():
                change_answer(self._store, self._answered(happened.trial), happened.answer)
            case events.HeadsetChecked():
                store_headset_check(self._store, self._session.id, happened.check)
            case events.Answered():
                record_answer(self._store, self._answered(happened.trial), happened.answer)
            case events.QuestionsLeft():
                skip_questionnaire(self._store, self._answered(happened.trial), happened.items)
            case events.TrialEnded():
                self._end(happened)
            case events.TrialSkipped():
                self._skip(happened)
            case events.Calibrated() | events.TorsoHeightCorrected():
                self._torso_height_m = happened.torso_height_m
                self._tell(happened)
            case _:
                self._tell(happened)

    def _begin(self, begun: events.TrialBegun) -> None:
        self._settle()
        position = self._trials[begun.trial - 1].position
        self._attempt = begin_attempt(
            self._store,
            self._session.id,
            position,
            begun.recording,
            torso_height_m=self._torso_height_m,
        )
        self._began_s = begun.time_s

    def _settle(self) -> None:
        """End an attempt whose end could not be stored, unless somebody else did."""
        for attempt in self._store.attempts(self._pseudonym):
            if self._attempt is not None and attempt.id == self._attempt.id and attempt.state == "running":
                end_attempt(self._store, attempt.id, "failed")
        self._attempt = None

    def _end(self, ended: events.TrialEnded) -> None:
        if self._attempt is None:
            return
        seconds = ended.time_s - self._began_s
        metrics = Metrics(ended.steps, ended.reward, ended.success, seconds)
        if ended.result == "completed":
            complete_attempt(self._store, self._attempt.id, metrics)
        else:
            end_attempt(self._store, self._attempt.id, ended.result, metrics)
        self._attempt = None

    def _skip(self, skipped: events.TrialSkipped) -> None:
        """Put a trial behind all others, where one that was skipped before is already."""
        position = self._trials[skipped.trial - 1].position
        if self._store.trials(self._pseudonym)[position - 1].state == "planned":
            skip_trial(self._store, self._session.id, position)

    def _tell(self, happened: SessionEvent) -> None:
        details = {name: value for name, value in asdict(happened).items() if name != "time_s"}
        name = re.sub(r"(?<!^)(?=[A-Z])", " ", type(happened).__name__).lower()
        detail = ", ".join(f"{key} {value}" for key, value in details.items())
        attempt = self._attempt.id if self._attempt is not None else None
        record_session_event(self._store, self._session.id, name, detail, attempt)

    def _answered(self, number: int) -> int:
        """The attempt whose questionnaire is open: the one that runs, or that completed the trial of this number."""
        if self._attempt is not None:
            return self._attempt.id
        trial = self._trials[number - 1]
        for attempt in self._store.attempts(self._pseudonym):
            if attempt.trial == trial.id and attempt.state == "completed":
                return attempt.id
        raise StudyError("there is no attempt that an answer could belong to")
