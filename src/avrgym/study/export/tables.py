"""Export a study as CSV tables."""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from msgspec.structs import asdict

from avrgym.study.design.design import Design
from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.codebook import (
    COLUMNS_BY_TABLE,
    EVENT_AND_NOTE_TABLES,
    INSTRUMENT_TABLES,
    compute_max_action_size,
    list_reward_terms,
    make_codebook_rows,
)
from avrgym.study.export.event_tables import (
    DEFAULT_EXPORT_OPTIONS,
    ExportOptions,
    make_audit_log_rows,
    make_event_and_note_tables,
)
from avrgym.study.export.exported_attempts import ExportedAttempt, list_all_attempts, list_participant_answers
from avrgym.study.export.scores import compute_scores, make_scale_rows, uses_instruments
from avrgym.study.export.table_files import write_csv
from avrgym.study.export.table_rows import (
    AttemptRow,
    ConsentRow,
    ControlStepRow,
    ItemRow,
    ParticipantRow,
    TrialRow,
)
from avrgym.study.storage.database_rows import ConsentText
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore

CONSENT_TEXTS_FOLDER = "consent_texts"
"""Folder of the consent texts in an export."""
CHECKSUM_DIGIT_COUNT = 12
"""Number of checksum digits in the file name of a consent text."""
TorsoHeightByAttempt = Mapping[int, float | None]
"""Torso heights (m), by attempt id."""


def write(
    store: StudyStore,
    completed: Sequence[ExportedAttempt],
    folder: Path,
    extras: ExportOptions = DEFAULT_EXPORT_OPTIONS,
) -> None:
    """Write all tables of a study as CSV into a folder. ``completed``: attempts for the table
    ``read_control_steps``.
    """
    (folder / "README.txt").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")
    attempts = list(list_all_attempts(store))
    heights: TorsoHeightByAttempt = {
        exported.attempt.id: exported.read_torso_height_m() for exported in completed
    }
    answered_items = AnsweredItems(store)
    for name, rows in make_participant_tables(store, attempts, completed, heights, answered_items).items():
        write_csv(folder / f"{name}.csv", rows)
    write_consent_texts(store, folder)
    write_csv(folder / "items.csv", make_item_rows(answered_items.design))
    records = make_event_and_note_tables(store, extras)
    for name, rows in records.items():
        write_csv(folder / f"{name}.csv", rows, COLUMNS_BY_TABLE[name])
    absent = {"left_out", *EVENT_AND_NOTE_TABLES} - set(records)
    if uses_instruments(answered_items.design):
        write_csv(folder / "scales.csv", make_scale_rows(answered_items.design))
    else:
        absent |= set(INSTRUMENT_TABLES)
    if store.read_audit_log():
        write_csv(folder / "log.csv", make_audit_log_rows(store, extras))
    else:
        absent |= {"log"}
    write_csv(folder / "control_steps.csv", _control_steps(store, completed))
    tables = [table for table in COLUMNS_BY_TABLE if table not in absent]
    write_csv(folder / "codebook.csv", make_codebook_rows(tables, store.design))


def make_participant_tables(
    store: StudyStore,
    attempts: list[ExportedAttempt],
    completed: Sequence[ExportedAttempt],
    heights: TorsoHeightByAttempt,
    answered_items: AnsweredItems,
) -> dict[str, Iterable[Any]]:
    """Returns the rows of all tables about participants, by table name. Each row is about one participant.

    ``attempts``: all attempts of the study. ``completed``: exported attempts, for the median torso heights.
    """
    tables: dict[str, Iterable[Any]] = {
        "participants": _participants(store, _median_heights(completed, heights)),
        "consents": make_consent_rows(store),
        "trials": _trials(store, attempts),
        "attempts": (_attempt(exported, heights) for exported in attempts),
        "answers": (
            answer.to_row()
            for participant in store.read_participants()
            for answer in list_participant_answers(store, participant, attempts, answered_items)
        ),
    }
    if uses_instruments(answered_items.design):
        tables["scores"] = (
            score.to_row()
            for participant in store.read_participants()
            for score in compute_scores(
                store,
                participant,
                list_participant_answers(store, participant, attempts, answered_items),
                answered_items,
            )
        )
    return tables


def _median_heights(completed: Sequence[ExportedAttempt], heights: TorsoHeightByAttempt) -> dict[str, float]:
    """Returns the median torso height (m) of each participant, by pseudonym."""
    heights_by_participant: dict[str, list[float]] = defaultdict(list)
    for exported in completed:
        height = heights[exported.attempt.id]
        if height is not None:
            heights_by_participant[exported.participant.pseudonym].append(height)
    return {pseudonym: median(values) for pseudonym, values in heights_by_participant.items()}


def make_item_rows(design: Design) -> Iterator[ItemRow]:
    """Yields a row for each item of the design's questionnaires."""
    for questionnaire in design.questionnaires:
        for item in questionnaire.items:
            scale = questionnaire.find_response_scale(item)
            yield ItemRow(
                questionnaire=questionnaire.name,
                when=", ".join(questionnaire.moments),
                order=questionnaire.order,
                item=item.id,
                text=item.text,
                minimum=scale.lowest_value,
                maximum=scale.highest_value,
                points=item.points,
                low=item.low,
                high=item.high,
            )


def make_consent_rows(store: StudyStore) -> Iterator[ConsentRow]:
    """Yields a row for each decision of each participant about a consent text, in order."""
    files = {archived.sha256: _consent_file(archived) for archived in store.read_consent_texts()}
    for participant in store.read_participants():
        for number, each in enumerate(store.read_consents(participant.pseudonym), start=1):
            yield ConsentRow(
                participant=participant.pseudonym,
                site=participant.site,
                simulated=participant.simulated,
                decision=number,
                role=each.consenter_role,
                agreed=each.agreed,
                version=each.version,
                language=each.language,
                decided_at=each.decided_at,
                sha256=each.sha256,
                text=files.get(each.sha256 or ""),
            )


def write_consent_texts(store: StudyStore, folder: Path) -> None:
    """Write each stored consent text to a file. The file name contains the text's checksum."""
    for archived in store.read_consent_texts():
        path = folder / _consent_file(archived)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(archived.text.encode())


def _consent_file(archived: ConsentText) -> str:
    return f"{CONSENT_TEXTS_FOLDER}/{archived.language}-{archived.sha256[:CHECKSUM_DIGIT_COUNT]}.txt"


def _participants(store: StudyStore, heights: Mapping[str, float]) -> Iterator[ParticipantRow]:
    for participant in store.read_participants():
        yield ParticipantRow(
            participant=participant.pseudonym,
            site=participant.site,
            site_participant=participant.pseudonym_at_site,
            simulated=participant.simulated,
            state=participant.state,
            sex=participant.sex,
            age_years=participant.age_years,
            language=participant.language or store.design.languages[0],
            torso_height_m=heights.get(participant.pseudonym),
            cell=participant.cell,
            consent_version=participant.consent_version,
            consented_at=participant.consented_at,
        )


def _trials(store: StudyStore, attempts: list[ExportedAttempt]) -> Iterator[TrialRow]:
    attempts_of_trial: dict[int, list[ExportedAttempt]] = defaultdict(list)
    for exported in attempts:
        attempts_of_trial[exported.trial.id].append(exported)
    for participant in store.read_participants():
        for trial in store.read_trials(participant.pseudonym):
            own = attempts_of_trial[trial.id]
            completed = [exported.attempt for exported in own if exported.attempt.state == "completed"]
            yield TrialRow(
                participant=participant.pseudonym,
                site=participant.site,
                simulated=participant.simulated,
                position=trial.position,
                practice=trial.practice,
                environment=trial.environment,
                policy=trial.policy,
                seed=trial.seed,
                state=trial.state,
                attempts=len(own),
                recording=completed[0].recording if completed else None,
            )


def _attempt(exported: ExportedAttempt, heights: TorsoHeightByAttempt) -> AttemptRow:
    attempt = exported.attempt
    return AttemptRow(
        **vars(exported.make_identifiers()),
        state=attempt.state,
        started_at=attempt.started_at,
        ended_at=attempt.ended_at,
        **asdict(attempt.metrics),
        torso_height_m=heights.get(attempt.id),
        input_method=attempt.input_profile.method if attempt.input_profile else None,
        recording=attempt.recording,
        sha256=attempt.sha256,
    )


def _control_steps(store: StudyStore, completed: Sequence[ExportedAttempt]) -> Iterator[dict[str, Any]]:
    terms, joints = list_reward_terms(store.design), range(compute_max_action_size(store.design))
    for exported in completed:
        labels = vars(exported.make_identifiers())
        for time_s, control in exported.read_control_steps():
            unknown = set(control.reward_terms) - set(terms)
            if unknown:
                raise StudyError(
                    f"{exported.attempt.recording}: unknown reward terms {', '.join(sorted(unknown))}; "
                    f"allowed: {', '.join(terms)}"
                )
            row = ControlStepRow(
                **labels,
                step=control.step,
                time_s=time_s,
                reward=control.reward,
                success=control.success,
                distance_m=control.distance_m,
                force_on_person_n=control.force_on_person_n,
            )
            yield {
                **vars(row),
                **{f"term_{term}": control.reward_terms.get(term) for term in terms},
                **{f"action_{joint + 1}": _action_of(control.action, joint) for joint in joints},
            }


def _action_of(action: Sequence[float], joint: int) -> float | None:
    """Returns the action of a joint, from −1 to 1; ``None`` if the arm does not have this joint."""
    return action[joint] if joint < len(action) else None
