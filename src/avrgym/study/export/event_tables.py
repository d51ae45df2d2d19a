"""Export events, adverse events, notes and the audit log.

Free text may contain names of people. Free text and names of experimenters are exported only with ``free_text``.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.functioning import count_functioning_answers, make_functioning_rows
from avrgym.study.export.table_files import extract_row_values, write_json, write_tsv
from avrgym.study.export.table_rows import AdverseEventRow, AuditLogRow, EventRow, NoteRow
from avrgym.study.people.adverse_events import group_reports_by_event
from avrgym.study.storage.audit_log import (
    ADD_EXPERIMENTER_ACTION,
    REVOKE_EXPERIMENTER_ACTION,
    read_site_names,
)
from avrgym.study.storage.database_rows import Participant, Trial, TrialAttempt, format_pseudonym
from avrgym.study.storage.sites import ROW_ID_STRIDE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column
from avrgym.system.files import write_folder_atomically

FREE_TEXT_EVENTS = ("participant withdrawn",)
"""Names of events whose detail is free text of an experimenter."""
TableRows = Sequence[object]
"""Rows of one table."""


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export.

    ``include_free_text``: export free text and names of experimenters. ``include_health_data``: export each
    participant's answers about functioning.
    """

    include_free_text: bool = False
    include_health_data: bool = False


DEFAULT_EXPORT_OPTIONS = ExportOptions()
"""Export neither free text nor health data."""


def make_event_and_note_tables(store: StudyStore, extras: ExportOptions) -> dict[str, TableRows]:
    """Returns the rows of events, adverse events, functioning and notes, by table name. ``extras``: export options."""
    people = store.read_participants()
    tables: dict[str, TableRows] = {
        "events": list(make_event_rows(store, people, extras)),
        "adverse_events": list(make_adverse_event_rows(store, people, extras)),
    }
    if store.design.ask_functioning:
        tables["functioning"] = list(count_functioning_answers(store))
    if extras.include_health_data:
        tables["functioning_by_person"] = list(
            make_functioning_rows(store, free_text=extras.include_free_text)
        )
    return tables | ({"notes": list(make_note_rows(store, people))} if extras.include_free_text else {})


def make_event_rows(
    store: StudyStore, people: Iterable[Participant], extras: ExportOptions
) -> Iterator[EventRow]:
    """Yields the events of these participants and of the whole study, in the order of storage."""
    known = {person.number: person for person in people}
    sessions, attempts = _session_numbers(store, known.values()), _attempts(store, known.values())
    participants = _session_participants(store)
    for event in store.read_events():
        number = event.participant or participants.get(event.session or 0)
        if number is not None and number not in known:
            continue
        person = known.get(number or 0)
        trial, attempt = attempts.get(event.attempt or 0, (None, None))
        shown = extras.include_free_text or event.name not in FREE_TEXT_EVENTS
        yield EventRow(
            participant=person.pseudonym if person else None,
            session=sessions.get(event.session or 0),
            position=trial.position if trial else None,
            attempt=attempt.number if attempt else None,
            simulated=person.simulated if person else None,
            at=event.recorded_at,
            name=event.name,
            detail=event.detail if shown else None,
        )


def make_adverse_event_rows(
    store: StudyStore, people: Iterable[Participant], extras: ExportOptions
) -> Iterator[AdverseEventRow]:
    """Yields all reports of the adverse events of these participants."""
    for person in people:
        trials = {trial.id: trial for trial in store.read_trials(person.pseudonym)}
        for event in group_reports_by_event(store.read_adverse_event_reports(person.pseudonym)):
            for number, report in enumerate(event.reports, start=1):
                trial = trials.get(report.trial or 0)
                yield AdverseEventRow(
                    participant=person.pseudonym,
                    site=person.site,
                    simulated=person.simulated,
                    event=event.event_number,
                    report=number,
                    recorded_at=report.recorded_at,
                    recorded_by=report.recorded_by if extras.include_free_text else None,
                    began_at=report.began_at,
                    position=trial and trial.position,
                    practice=trial and trial.practice,
                    task=trial and trial.task,
                    robot=trial and trial.robot,
                    policy=trial and trial.policy,
                    description=report.description if extras.include_free_text else None,
                    severity=report.severity,
                    seriousness=report.seriousness,
                    relatedness=report.relatedness,
                    action=report.action if extras.include_free_text else None,
                    outcome=report.outcome,
                )


def make_note_rows(store: StudyStore, people: Iterable[Participant]) -> Iterator[NoteRow]:
    """Yields the experimenters' notes about these participants."""
    for person in people:
        sessions = _session_numbers(store, [person])
        for note in store.read_notes(person.pseudonym):
            session = sessions.get(note.session or 0)
            yield NoteRow(
                person.pseudonym, person.site, person.simulated, session, note.written_at, note.text
            )


def make_audit_log_rows(store: StudyStore, extras: ExportOptions) -> Iterator[AuditLogRow]:
    """Yields all entries of the audit log. A number replaces each person's name, unless ``free_text`` is set."""
    entries, sites = store.read_audit_log(), read_site_names(store)
    people = dict.fromkeys(
        (entry.id // ROW_ID_STRIDE, entry.person, entry.identified_by) for entry in entries
    )
    codes = {person: f"person {number}" for number, person in enumerate(people, start=1)}
    for entry in entries:
        site = entry.id // ROW_ID_STRIDE
        has_name = entry.action in (ADD_EXPERIMENTER_ACTION, REVOKE_EXPERIMENTER_ACTION)
        yield AuditLogRow(
            entry=entry.id,
            site=sites.get(site) or store.design.site or None,
            at=entry.recorded_at,
            person=entry.person
            if extras.include_free_text
            else codes[site, entry.person, entry.identified_by],
            known_by=entry.identified_by,
            name=entry.action,
            participant=None if entry.participant is None else format_pseudonym(entry.participant),
            detail=None if has_name and not extras.include_free_text else entry.detail or None,
            completed=entry.completed,
            planned=entry.planned,
        )


def write_adverse_events(store: StudyStore, out: Path) -> None:
    """Write all reports of adverse events with free text, and a codebook, into a new folder.

    Only the owner of the folder can open it.

    Raises:
        StudyError: if the folder is not empty.
        OSError: if the folder cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StudyError(f"{out} is not empty; choose another folder")
    rows = list(
        make_adverse_event_rows(store, store.read_participants(), ExportOptions(include_free_text=True))
    )
    write_folder_atomically(out, lambda folder: write_table(folder, "adverse_events", rows))


def write_table(folder: Path, name: str, rows: TableRows) -> None:
    """Write a table as TSV, and the descriptions of its columns as JSON. ``name``: a key of
    ``codebook.COLUMNS_BY_TABLE``.
    """
    columns = COLUMNS_BY_TABLE[name]
    write_tsv(
        folder / f"{name}.tsv", [list(columns), *(list(extract_row_values(row).values()) for row in rows)]
    )
    write_json(folder / f"{name}.json", {name: _described(column) for name, column in columns.items()})


def _described(column: Column) -> dict[str, str]:
    unit = {"Units": column.unit} if column.unit else {}
    allowed = {"Allowed": column.allowed} if column.allowed else {}
    return {"Description": column.meaning, **unit, **allowed}


def _session_numbers(store: StudyStore, people: Iterable[Participant]) -> dict[int, int]:
    """Returns the number of each session within its participant (from 1), by the session's id."""
    return {each.id: each.number for person in people for each in store.read_sessions(person.pseudonym)}


def _session_participants(store: StudyStore) -> dict[int, int]:
    """Returns the number of each session's participant, by the session's id."""
    people = store.read_participants()
    return {
        session.id: session.participant for each in people for session in store.read_sessions(each.pseudonym)
    }


def _attempts(store: StudyStore, people: Iterable[Participant]) -> dict[int, tuple[Trial, TrialAttempt]]:
    """Returns each attempt with its trial, by the attempt's id."""
    found: dict[int, tuple[Trial, TrialAttempt]] = {}
    for person in people:
        trials = {trial.id: trial for trial in store.read_trials(person.pseudonym)}
        found |= {
            each.id: (trials[each.trial], each)
            for each in store.read_attempts(person.pseudonym)
            if each.trial in trials
        }
    return found
