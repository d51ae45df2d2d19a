"""Rows for the exports about events in a study, and texts of experimenters.

Free text may name people. It is exported only on request, and so are the names of experimenters.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrgym.study.export.codebook import TABLES, Column
from avrgym.study.export.functioning import functioning_rows, individual_rows
from avrgym.study.export.separated import write_json, write_rows
from avrgym.study.people.adverse_events import group_by_event
from avrgym.study.storage.rows import Participant, Trial, TrialAttempt
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.system.files import write_folder_atomically
from avrgym.tasks.registry import find_environment

WITH_FREE_TEXT = ("participant withdrawn",)
"""Events whose detail an experimenter wrote."""


@dataclass(frozen=True)
class Extras:
    """Data that are exported only on request.

    ``free_text``: texts and names of experimenters. ``health``: each person's answers about functioning.
    """

    free_text: bool = False
    health: bool = False


WITHOUT = Extras()
"""Nothing of it."""


def records_of(store: Store, extras: Extras) -> dict[str, list[dict[str, Any]]]:
    """The rows of each table that an export has, by the table's name."""
    people = store.participants()
    tables = {
        "events": list(event_rows(store, people, extras)),
        "adverse_events": list(adverse_event_rows(store, people, extras)),
    }
    if store.design.ask_functioning:
        tables["functioning"] = list(functioning_rows(store))
    if extras.health:
        tables["functioning_by_person"] = list(individual_rows(store, free_text=extras.free_text))
    return tables | ({"notes": list(note_rows(store, people))} if extras.free_text else {})


def event_rows(store: Store, people: Iterable[Participant], extras: Extras) -> Iterator[dict[str, Any]]:
    """Events of these participants and of the whole study, in the order of storage."""
    known = {person.number: person for person in people}
    sessions, attempts = _sessions(store, known.values()), _attempts(store, known.values())
    visitors = _visitors(store)
    for event in store.events():
        number = event.participant or visitors.get(event.session or 0)
        if number is not None and number not in known:
            continue
        person = known.get(number or 0)
        trial, attempt = attempts.get(event.attempt or 0, (None, None))
        shown = extras.free_text or event.name not in WITH_FREE_TEXT
        yield {
            "participant": person.pseudonym if person else None,
            "session": sessions.get(event.session or 0),
            "position": trial.position if trial else None,
            "attempt": attempt.number if attempt else None,
            "simulated": person.simulated if person else None,
            "at": event.at,
            "name": event.name,
            "detail": event.detail if shown else None,
        }


def adverse_event_rows(
    store: Store, people: Iterable[Participant], extras: Extras
) -> Iterator[dict[str, Any]]:
    """Every report of every adverse event of these participants."""
    for person in people:
        trials = {trial.id: trial for trial in store.trials(person.pseudonym)}
        for event in group_by_event(store.adverse_events(person.pseudonym)):
            for number, report in enumerate(event.reports, start=1):
                yield {
                    **_whose(person),
                    "event": event.number,
                    "report": number,
                    "recorded_at": report.recorded_at,
                    "recorded_by": report.recorded_by if extras.free_text else None,
                    "began_at": report.began_at,
                    **_condition(trials.get(report.trial or 0)),
                    "description": report.description if extras.free_text else None,
                    "severity": report.severity,
                    "seriousness": report.seriousness,
                    "relatedness": report.relatedness,
                    "action": report.action if extras.free_text else None,
                    "outcome": report.outcome,
                }


def note_rows(store: Store, people: Iterable[Participant]) -> Iterator[dict[str, Any]]:
    """The experimenter's notes on these participants."""
    for person in people:
        sessions = _sessions(store, [person])
        for note in store.notes(person.pseudonym):
            yield {
                **_whose(person),
                "session": sessions.get(note.session or 0),
                "at": note.at,
                "text": note.text,
            }


def write_adverse_events(store: Store, out: Path) -> None:
    """Write every report with its free text, and a codebook, into a new folder that only its owner may open.

    Raises:
        StudyError: when the folder holds something.
        OSError: when it cannot be written.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise StudyError(f"{out} holds something already; choose another folder")
    rows = adverse_event_rows(store, store.participants(), Extras(free_text=True))
    write_folder_atomically(out, lambda folder: write_table(folder, "adverse_events", rows))


def write_table(folder: Path, name: str, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write a table as TSV, also an empty one, and next to it the meaning of its columns as JSON."""
    columns = TABLES[name]
    write_rows(folder / f"{name}.tsv", [list(columns), *(list(row.values()) for row in rows)])
    described = {head: _described(column) for head, column in columns.items()}
    write_json(folder / f"{name}.json", described)


def _described(column: Column) -> dict[str, str]:
    unit = {"Units": column.unit} if column.unit else {}
    allowed = {"Allowed": column.allowed} if column.allowed else {}
    return {"Description": column.meaning, **unit, **allowed}


def _whose(person: Participant) -> dict[str, Any]:
    return {"participant": person.pseudonym, "site": person.site, "simulated": person.simulated}


def _condition(trial: Trial | None) -> dict[str, Any]:
    task, robot = find_environment(trial.environment) if trial else (None, None)
    return {
        "position": trial.position if trial else None,
        "practice": trial.practice if trial else None,
        "task": task,
        "robot": robot,
        "policy": trial.policy if trial else None,
    }


def _sessions(store: Store, people: Iterable[Participant]) -> dict[int, int]:
    """The numbers of sessions by id."""
    return {each.id: each.number for person in people for each in store.sessions(person.pseudonym)}


def _visitors(store: Store) -> dict[int, int]:
    """The number of the participant of each session by its id."""
    people = store.participants()
    return {visit.id: visit.participant for each in people for visit in store.sessions(each.pseudonym)}


def _attempts(store: Store, people: Iterable[Participant]) -> dict[int, tuple[Trial, TrialAttempt]]:
    """Trial and attempt by the attempt's id."""
    found: dict[int, tuple[Trial, TrialAttempt]] = {}
    for person in people:
        trials = {trial.id: trial for trial in store.trials(person.pseudonym)}
        found |= {
            each.id: (trials[each.trial], each)
            for each in store.attempts(person.pseudonym)
            if each.trial in trials
        }
    return found
