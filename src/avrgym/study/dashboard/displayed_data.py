"""Contents of the experimenter's dashboard. They contain no names, and for blinded experimenters no policies."""

import shutil
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from avrgym.commands.input_methods import InputMethod, StopInput
from avrgym.commands.preferences import DEFAULT_PREFERENCES, Preferences, describe_preferences
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.recording.input_profile import ALLOWED_STOP_INPUTS, DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.recording.schema import Metrics
from avrgym.study.checking.study_summary import (
    ConditionResults,
    StudySummary,
    summarise_results,
    summarise_study,
)
from avrgym.study.design.design import Design
from avrgym.study.export.exported_attempts import list_participant_answers, list_participant_attempts
from avrgym.study.export.scores import compute_scores, uses_instruments
from avrgym.study.people.adverse_events import (
    ADVERSE_EVENT_RATING_SCALES,
    ADVERSE_EVENT_SCALE_SOURCES,
    AdverseEventDetails,
    SafetyEvent,
    group_reports_by_event,
    list_safety_events,
)
from avrgym.study.people.consents import describe_consent, find_missing_consent_role
from avrgym.study.people.furniture import read_own_furniture
from avrgym.study.people.participants import read_consent_text, read_participant_texts
from avrgym.study.people.preferences import read_latest_preferences
from avrgym.study.people.retention import describe_due_deletions, today_utc
from avrgym.study.storage.answers import find_attempts_with_open_questionnaire
from avrgym.study.storage.database_rows import ExperimenterNote, Participant, Trial, TrialAttempt
from avrgym.study.storage.identity_file import read_pseudonyms_with_identity
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.session_summary import SessionSummary, summarise_sessions
from avrgym.study.storage.state_transitions import PARTICIPANT_TRANSITIONS
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import read_texts
from avrgym.vr.server.session_links import SessionLinks

MIN_FREE_DISK_BYTES = 2_000_000_000
"""Free disk space (bytes) below which the dashboard shows a warning. A recorded trial of 20 s has a few MB."""


@dataclass(frozen=True)
class SessionAccess:
    """Access to the running session: addresses with the session link, and the code for the headset."""

    addresses: tuple[str, ...]
    code: str


def make_session_access(
    links: SessionLinks, addresses: Callable[[str], Sequence[str]]
) -> SessionAccess | None:
    """Returns addresses and headset code of the running session; ``None`` without a session.

    ``addresses``: function that returns the addresses with a link.
    """
    link, code = links.current_link_token, links.get_or_create_code()
    return None if link is None or code is None else SessionAccess(tuple(addresses(link)), code)


@dataclass(frozen=True)
class StudyOverview:
    """Overview of the whole study.

    ``live``: pseudonym of the running session's participant. ``furniture``: the real seat and bed for the next session.
    ``languages``: names of languages by tag. ``experimenter``: name of the experimenter. ``scales``: rating scales of
    adverse events; ``scales_words``: their sources. ``input_stops``: the ways to stop of each input method.
    ``caregiver_addresses``: addresses of the caregiver's page.
    """

    summary: StudySummary
    consent_version: str
    languages: dict[str, str]
    warnings: tuple[str, ...]
    live: str | None
    furniture: RealFurniture
    experimenter: str
    scales: Mapping[str, tuple[str, ...]]
    scales_words: str
    input_stops: Mapping[InputMethod, tuple[StopInput, ...]]
    link: SessionAccess | None
    caregiver_addresses: tuple[str, ...] = ()


@dataclass(frozen=True)
class DisplayedResults:
    """The current results, sent only on request. ``items``: texts of items by id."""

    blinded: bool
    items: dict[str, str]
    results: tuple[ConditionResults, ...]


@dataclass(frozen=True)
class DisplayedTrial:
    """A trial, without information that a blinded experimenter must not see. ``attempts``: states of its attempts.

    ``questionnaire_open``: the trial is completed and has unanswered items.
    """

    position: int
    task: str
    robot: str
    policy: str
    practice: bool
    state: str
    attempts: tuple[str, ...]
    success: bool | None
    reward: float | None
    questionnaire_open: bool


@dataclass(frozen=True)
class DisplayedScore:
    """Score of a validated questionnaire at a moment. ``position``: position of the trial (for scores after trials)."""

    moment: str
    position: int | None
    instrument: str
    scale: str
    score: float | None
    minimum: float
    maximum: float


@dataclass(frozen=True)
class DisplayedAdverseEvent:
    """An adverse event: its number, its number of reports, and its latest report."""

    number: int
    reports: int
    recorded_at: str
    report: AdverseEventDetails


@dataclass(frozen=True)
class DisplayedParticipant:
    """One participant. ``identified``: the identity file has an entry. ``may_become``: allowed next states.

    ``consent`` and ``inclusion`` (texts by id) are in the participant's ``language``. ``must_reconsent``: the
    participant accepted another version of the consent text. ``input``: the input profile; ``input_words``: the same in
    one line. ``consents``: all consent decisions as text. ``missing_consent``: ``proxy`` or ``assent`` if only the
    other one was given. ``respondent``: role of the person that answers the questionnaires. ``furniture``: their own
    seat and bed, if measured. ``preferences``: for the robot, ``None`` if no condition uses them;
    ``preferences_words``: the same as text.
    """

    participant: str
    state: str
    may_become: tuple[str, ...]
    simulated: bool
    sex: str
    age_years: int | None
    input: InputProfile
    input_words: str
    identified: bool
    language: str
    direction: str
    consent: str
    inclusion: dict[str, str]
    consented_at: str | None
    consent_version: str | None
    must_reconsent: bool
    consents: tuple[str, ...]
    missing_consent: str
    respondent: str
    furniture: RealFurniture | None
    preferences: Preferences | None
    preferences_words: str
    sessions: tuple[SessionSummary, ...]
    scores: tuple[DisplayedScore, ...]
    trials: tuple[DisplayedTrial, ...]
    notes: tuple[ExperimenterNote, ...]
    adverse_events: tuple[DisplayedAdverseEvent, ...]
    safety_events: tuple[SafetyEvent, ...]


def make_study_overview(
    store: StudyStore,
    live: str | None,
    furniture: RealFurniture,
    experimenter: str = "",
    link: SessionAccess | None = None,
    caregiver_addresses: tuple[str, ...] = (),
) -> StudyOverview:
    """Returns the overview of a study; ``live``: pseudonym of the running session's participant."""
    design = store.design
    return StudyOverview(
        summary=summarise_study(store),
        consent_version=design.consent.version,
        languages={language: read_texts(language, store.folder).name for language in design.languages},
        warnings=(*_short(store), *_due(store)),
        live=live,
        furniture=furniture,
        experimenter=experimenter,
        scales=ADVERSE_EVENT_RATING_SCALES,
        scales_words=ADVERSE_EVENT_SCALE_SOURCES,
        input_stops=ALLOWED_STOP_INPUTS,
        link=link,
        caregiver_addresses=caregiver_addresses,
    )


def make_displayed_results(store: StudyStore) -> DisplayedResults:
    """Returns the results of completed trials for each condition."""
    answered_items = AnsweredItems(store)
    return DisplayedResults(
        blinded=store.design.blind_experimenter,
        items={name: item.text for name, item in answered_items.design.items_by_id.items()},
        results=summarise_results(store, answered_items),
    )


def make_displayed_participant(store: StudyStore, pseudonym: str) -> DisplayedParticipant:
    """Returns the dashboard's data about one participant. Raises ``StudyError`` for an unknown pseudonym."""
    participant, design = store.read_participant(pseudonym), store.design
    texts = read_participant_texts(store, participant)
    input_profile = participant.input_profile or DEFAULT_INPUT_PROFILE
    attempts = defaultdict[int, list[TrialAttempt]](list)
    for attempt in store.read_attempts(pseudonym):
        attempts[attempt.trial].append(attempt)
    consents = store.read_consents(pseudonym)
    applies = any(rules.preferences for rules in design.conditions.values())
    own = (read_latest_preferences(store, pseudonym) or DEFAULT_PREFERENCES) if applies else None
    left = {
        attempt.trial
        for attempt in find_attempts_with_open_questionnaire(store, store.read_attempts(pseudonym))
    }
    return DisplayedParticipant(
        participant=pseudonym,
        state=participant.state,
        may_become=PARTICIPANT_TRANSITIONS[participant.state],
        simulated=participant.simulated,
        sex=participant.sex,
        age_years=participant.age_years,
        input=msgspec.structs.replace(input_profile, stops=input_profile.stop_inputs),
        input_words=input_profile.describe(),
        identified=pseudonym in read_pseudonyms_with_identity(store.folder),
        language=texts.language,
        direction=texts.direction,
        consent=read_consent_text(store, participant).text,
        inclusion={question.id: texts.translate(question.text) for question in design.inclusion},
        consented_at=participant.consented_at,
        consent_version=participant.consent_version,
        must_reconsent=participant.must_reconsent(design.consent.version),
        consents=tuple(describe_consent(each) for each in consents),
        missing_consent=find_missing_consent_role(consents, design.consent.version),
        furniture=read_own_furniture(store, pseudonym),
        preferences=own,
        preferences_words="" if own is None else describe_preferences(own, texts.language),
        respondent=participant.effective_respondent,
        sessions=tuple(summarise_sessions(store, pseudonym)),
        scores=tuple(_scores(store, participant)),
        trials=tuple(
            _trial(design, trial, attempts[trial.id], left) for trial in store.read_trials(pseudonym)
        ),
        notes=tuple(store.read_notes(pseudonym)),
        adverse_events=tuple(_adverse_events(store, pseudonym)),
        safety_events=tuple(list_safety_events(store, pseudonym)),
    )


def _short(store: StudyStore) -> Iterator[str]:
    """Yields a warning if less than ``MIN_FREE_DISK_BYTES`` of disk space are free."""
    free = shutil.disk_usage(store.folder).free
    if free < MIN_FREE_DISK_BYTES:
        yield (
            f"The disk of {store.folder} has {free / 1e9:.1f} GB left; recordings stop when it is full. "
            "Free disk space before the next session."
        )


def _due(store: StudyStore) -> Iterator[str]:
    """Yields a sentence for each kind of data after the end of its retention period."""
    return (f"Retention: {words}." for words in describe_due_deletions(store, today_utc()))


def _scores(store: StudyStore, participant: Participant) -> Iterator[DisplayedScore]:
    if not uses_instruments(store.design):
        return
    attempts, answered_items = (
        list(list_participant_attempts(store, participant)),
        AnsweredItems(store, [participant]),
    )
    for score in compute_scores(
        store,
        participant,
        list_participant_answers(store, participant, attempts, answered_items),
        answered_items,
    ):
        row = score.to_row()
        yield DisplayedScore(**{name: getattr(row, name) for name in DisplayedScore.__dataclass_fields__})


def _adverse_events(store: StudyStore, pseudonym: str) -> Iterator[DisplayedAdverseEvent]:
    positions = {trial.id: trial.position for trial in store.read_trials(pseudonym)}
    for event in group_reports_by_event(store.read_adverse_event_reports(pseudonym)):
        latest = event.latest_report
        known: dict[str, Any] = {
            name: getattr(latest, name) for name in AdverseEventDetails.__struct_fields__
        }
        known["trial"] = positions.get(latest.trial or 0)
        report = AdverseEventDetails(**known)
        yield DisplayedAdverseEvent(event.event_number, len(event.reports), latest.recorded_at, report)


def _trial(design: Design, trial: Trial, attempts: list[TrialAttempt], left: set[int]) -> DisplayedTrial:
    task, robot = trial.task, trial.robot
    metrics = next((attempt.metrics for attempt in attempts if attempt.state == "completed"), Metrics())
    return DisplayedTrial(
        position=trial.position,
        task=task,
        robot=robot,
        policy=design.choose_displayed_policy(trial.policy, trial.practice),
        practice=trial.practice,
        state=trial.state,
        attempts=tuple(attempt.state for attempt in attempts),
        success=metrics.success,
        reward=metrics.reward,
        questionnaire_open=trial.id in left,
    )
