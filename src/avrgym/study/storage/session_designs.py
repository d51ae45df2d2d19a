"""The design that each session used, read from the database, or from the session's recordings."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import RecordingError, read_header
from avrgym.study.design.design import Design, InclusionQuestion
from avrgym.study.design.design_comparison import DesignTexts, design_from_dict
from avrgym.study.storage.database_rows import Participant, StoredDesign, StudySession, Trial, TrialAttempt
from avrgym.study.storage.sites import SITE_DIFFERENCE_EVENT
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import InvalidTextsError, normalize_whitespace, read_texts

SentenceTranslator = Callable[[str], str]
"""Function that translates an English sentence of a design."""
AFTER_TRIAL_MOMENT = "after_trial"
"""The moment of questions about a trial, one of ``QUESTION_MOMENTS``."""


def design_from_recording(
    design: Design, trial: Trial, configuration: TrialConfiguration, translate: SentenceTranslator
) -> Design:
    """Returns the design that a trial used, from the configuration in the trial's recording.

    Args:
        design: the design with the values that recordings do not contain.
        trial: the trial.
        configuration: the configuration in the trial's recording; fields that are ``None`` are ignored.
        translate: function that translates a sentence of the design into the participant's language.
    """
    changes: dict[str, Any] = {
        "trial_steps": configuration.planned_steps,
        "force_guard": configuration.force_guard,
        "withdraw_after_success": configuration.withdraw_after_success,
        "furniture": configuration.furniture,
    }
    if configuration.settings != design.find_condition_settings(trial.policy):
        changes["settings"] = configuration.settings
    if configuration.free_movement_s is not None:
        changes["free_movement_s"] = configuration.free_movement_s
    if configuration.stop_rules is not None:
        changes["stop_rules"] = configuration.stop_rules
    task = trial.task
    expected = design.find_task_instruction(task, trial.policy)
    if configuration.goal not in (expected, translate(expected)):
        changes["goals"] = {**design.goals, task: configuration.goal}
    if not trial.practice:
        changes["questionnaires"] = _asked(design, trial.seed, configuration.items, translate)
    return msgspec.structs.replace(design, **changes)


def _asked(
    design: Design, seed: int, items: Sequence[Item], translate: SentenceTranslator
) -> tuple[Questionnaire, ...]:
    """Returns the design's questionnaires; those after a trial contain only the recorded ``items``."""
    known = {item.id: item for item in design.items_by_id.values()}
    asked = {item.id: _in_design(item, known.get(item.id), translate) for item in items}
    for order in ("as designed", "fixed", "random"):
        found = tuple(_with_items(each, asked, order) for each in design.questionnaires)
        found = _with_others(found, asked)
        again = msgspec.structs.replace(design, questionnaires=found).list_items_at_moment(
            AFTER_TRIAL_MOMENT, seed
        )
        if [item.id for item in again] == list(asked):
            return found
    return tuple(_sorted(each, list(asked)) for each in found)


def _in_design(item: Item, known: Item | None, translate: SentenceTranslator) -> Item:
    """Returns the design's item if the recorded text is its translation; otherwise the recorded item."""
    return known if known is not None and item in (known, translate_item(known, translate)) else item


def translate_item(item: Item, translate: SentenceTranslator) -> Item:
    """Returns the item with translated texts."""
    return msgspec.structs.replace(
        item,
        text=translate(item.text),
        low=translate(item.low),
        high=translate(item.high),
        labels=tuple(translate(label) for label in item.labels),
    )


def _with_items(questionnaire: Questionnaire, asked: Mapping[str, Item], order: str) -> Questionnaire:
    if AFTER_TRIAL_MOMENT not in questionnaire.moments:
        return questionnaire
    own = tuple(asked[item.id] for item in questionnaire.items if item.id in asked)
    order = questionnaire.order if order == "as designed" else order
    return msgspec.structs.replace(questionnaire, items=own, order=order)


def _with_others(
    questionnaires: tuple[Questionnaire, ...], asked: Mapping[str, Item]
) -> tuple[Questionnaire, ...]:
    """Returns the questionnaires, and one for recorded items that no questionnaire after trials contains."""
    known = {item.id for each in questionnaires if AFTER_TRIAL_MOMENT in each.moments for item in each.items}
    others = tuple(item for item in asked.values() if item.id not in known)
    return (
        (*questionnaires, Questionnaire("recorded", AFTER_TRIAL_MOMENT, others)) if others else questionnaires
    )


def _sorted(questionnaire: Questionnaire, ids: Sequence[str]) -> Questionnaire:
    if AFTER_TRIAL_MOMENT not in questionnaire.moments:
        return questionnaire
    own = tuple(sorted(questionnaire.items, key=lambda item: ids.index(item.id)))
    return msgspec.structs.replace(questionnaire, items=own, order="fixed")


@dataclass(frozen=True)
class SessionDesign:
    """The design of a session.

    ``trial_positions``: positions of the trials that used this design. ``design_texts``: the texts for participants;
    ``None`` if the database does not contain the session's design.
    """

    participant: Participant
    session: StudySession
    trial_positions: tuple[int, ...]
    design: Design
    design_texts: DesignTexts | None

    @property
    def language(self) -> str:
        """The language tag of the texts that the participant read, such as ``de``."""
        return self.participant.language or self.design.languages[0]


def read_session_designs(
    store: StudyStore, participants: Sequence[Participant] | None = None
) -> list[SessionDesign]:
    """Returns the designs of all sessions, from the database, or from the recordings of a session without one.

    ``participants``: only sessions of these participants; default: all participants.
    """
    stored = _stored(store)
    return [
        entry
        for participant in (store.read_participants() if participants is None else participants)
        for session, attempts in _sessions(store, participant)
        for entry in _designs_of(store, participant, session, attempts, stored.get(session.id))
    ]


def read_designs_from_recordings(store: StudyStore) -> list[SessionDesign]:
    """Returns the designs of all sessions, from the sessions' recordings.

    Values that recordings lack are read from the database, or from the study's current design. Trials without a
    readable recording are omitted. The inclusion questions are the questions that the participant answered.
    """
    stored, admitted = _stored(store), _admitted(store)
    return [
        replace(entry, design=msgspec.structs.replace(entry.design, inclusion=admitted[participant.number]))
        if participant.number in admitted
        else entry
        for participant in store.read_participants()
        for session, attempts in _sessions(store, participant)
        for entry in _recorded(store, participant, session, attempts, stored.get(session.id))
    ]


def design_from_row(row: StoredDesign) -> Design:
    """Returns the design that a database row contains. Raises ``StudyError`` if the row is damaged."""
    try:
        return design_from_dict(row.design)
    except msgspec.ValidationError as error:
        raise StudyError(
            f"the study's database: design {row.id} is damaged: {error}; restore a backup"
        ) from error


def make_sentence_translator(
    store: StudyStore, language: str, wordings: DesignTexts | None
) -> Callable[[str], str]:
    """Returns a function that translates a design's sentences into a language.

    It uses the stored ``wordings``; if they are ``None``, the study's current texts.
    """
    if wordings is not None:
        known = wordings.get(language, {}).get("sentences", {})
        return lambda sentence: known.get(normalize_whitespace(sentence), sentence)
    try:
        return read_texts(language, store.folder).translate
    except InvalidTextsError:
        return lambda sentence: sentence


def describe_trials(sessions: Iterable[SessionDesign], everyone: Iterable[SessionDesign] = ()) -> str:
    """Returns participants and positions of their trials as text. ``everyone``: all session designs of the study."""
    own, names = list(sessions), list[str]()
    if own and {_key(entry) for entry in own} == {_key(entry) for entry in everyone}:
        people = {entry.participant.pseudonym for entry in own}
        trials = sum(len(entry.trial_positions) for entry in own)
        return f"all participants ({', '.join(sorted(people))}: {trials} trials)"
    for pseudonym in dict.fromkeys(entry.participant.pseudonym for entry in own):
        positions = sorted(
            {at for entry in own if entry.participant.pseudonym == pseudonym for at in entry.trial_positions}
        )
        names.append(f"{pseudonym} ({_ranges(positions)})")
    return ", ".join(names)


def is_accepted_site_difference(
    store: StudyStore, own: Sequence[SessionDesign], sessions: Sequence[SessionDesign]
) -> bool:
    """Returns whether a difference exists only between sites and was accepted at the merge.

    ``own``: sessions with the difference. ``sessions``: all sessions of the study.
    """
    accepted = any(event.name == SITE_DIFFERENCE_EVENT for event in store.read_events())
    sites = {entry.participant.site for entry in own}
    whole = [entry for entry in sessions if entry.participant.site in sites]
    return accepted and len(whole) == len(own)


def _key(entry: SessionDesign) -> tuple[int, tuple[int, ...]]:
    return entry.session.id, entry.trial_positions


def _ranges(positions: list[int]) -> str:
    """Returns the positions of trials as text, such as "trials 1 to 4"."""
    if not positions:
        return "no trial"
    ranges: list[list[int]] = []
    for at in positions:
        if ranges and at == ranges[-1][-1] + 1:
            ranges[-1].append(at)
        else:
            ranges.append([at])
    words = ", ".join(str(own[0]) if len(own) == 1 else f"{own[0]} to {own[-1]}" for own in ranges)
    return f"{'trial' if len(positions) == 1 else 'trials'} {words}"


def _admitted(store: StudyStore) -> dict[int, tuple[InclusionQuestion, ...]]:
    """Returns the inclusion questions that each participant answered, by participant number."""
    return {
        row.participant: design_from_row(row).inclusion
        for row in store.read_stored_designs()
        if row.session is None
    }


def _stored(store: StudyStore) -> dict[int, StoredDesign]:
    return {row.session: row for row in store.read_stored_designs() if row.session is not None}


def _sessions(
    store: StudyStore, participant: Participant
) -> Iterator[tuple[StudySession, list[TrialAttempt]]]:
    attempts = store.read_attempts(participant.pseudonym)
    for session in store.read_sessions(participant.pseudonym):
        yield session, [each for each in attempts if each.session == session.id]


def _designs_of(
    store: StudyStore,
    participant: Participant,
    session: StudySession,
    attempts: list[TrialAttempt],
    stored: StoredDesign | None,
) -> Iterator[SessionDesign]:
    if stored is None:
        yield from _recorded(store, participant, session, attempts, None)
        return
    positions = {trial.id: trial.position for trial in store.read_trials(participant.pseudonym)}
    run = sorted({positions[each.trial] for each in attempts if each.trial in positions})
    yield SessionDesign(participant, session, tuple(run), design_from_row(stored), stored.wordings)


def _recorded(
    store: StudyStore,
    participant: Participant,
    session: StudySession,
    attempts: list[TrialAttempt],
    stored: StoredDesign | None,
) -> Iterator[SessionDesign]:
    """Yields all different designs in the recordings of a session.

    Without a stored design, missing values come from the other recordings of the session.
    """
    design = store.design if stored is None else design_from_row(stored)
    wordings = None if stored is None else stored.wordings
    translate = make_sentence_translator(store, participant.language or design.languages[0], wordings)
    trials = {trial.id: trial for trial in store.read_trials(participant.pseudonym)}
    configurations = list[tuple[Trial, TrialConfiguration]]()
    for attempt in attempts:
        with suppress(OSError, RecordingError, StudyError, KeyError):  # other checks report it
            configurations.append(
                (trials[attempt.trial], read_header(store.resolve_path(attempt.recording)).configuration)
            )
    if stored is None:
        for each in configurations:
            design = design_from_recording(design, *each, translate)
    found: dict[bytes, tuple[Design, set[int]]] = {}
    for trial, configuration in configurations:
        recorded = design_from_recording(design, trial, configuration, translate)
        found.setdefault(_content(recorded), (recorded, set()))[1].add(trial.position)
    if stored is not None and not found:
        found[b""] = design, set[int]()
    for recorded, positions in found.values():
        yield SessionDesign(participant, session, tuple(sorted(positions)), recorded, wordings)


def _content(design: Design) -> bytes:
    return msgspec.json.encode(design, order="deterministic")
