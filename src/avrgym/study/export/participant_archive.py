"""Archive of all data of one participant, for the participant's right of access."""

import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import msgspec

from avrgym.study.export.codebook import COLUMNS_BY_TABLE, make_codebook_rows
from avrgym.study.export.event_tables import (
    DEFAULT_EXPORT_OPTIONS,
    ExportOptions,
    make_adverse_event_rows,
    make_audit_log_rows,
    make_event_rows,
    make_note_rows,
)
from avrgym.study.export.exported_attempts import list_participant_attempts
from avrgym.study.export.scores import make_scale_rows, uses_instruments
from avrgym.study.export.table_files import write_csv
from avrgym.study.export.table_rows import EventRow
from avrgym.study.export.tables import make_item_rows, make_participant_tables, write_consent_texts
from avrgym.study.storage import identity_file
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, Participant
from avrgym.study.storage.item_versions import AnsweredItems
from avrgym.study.storage.remote_recordings import fetch_recordings
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import open_privately

INDEX_FILE = "README.md"
"""File that lists the contents of the archive."""
EVENTS_WITH_OTHER_PSEUDONYMS = ("participant enrolled", "identity corrected")
"""Names of events whose detail can contain pseudonyms of other participants."""
FILE_DESCRIPTIONS: Mapping[str, str] = {
    "identity.json": "Name and contact, from the identity file.",
    "participants.csv": "The participant's record: body model, age, language, state, consent.",
    "inclusion.json": "The answers to the inclusion questions.",
    "functioning.json": "The person's answers about disability, diagnosis and assistive devices.",
    "consents.csv": "Each decision about a consent text.",
    "consent_texts/": "The consent texts of the study.",
    "trials.csv": "The planned trials in their order.",
    "attempts.csv": "Each attempt at a trial with its results.",
    "answers.csv": "Each answer to a question.",
    "items.csv": "The text of each question.",
    "scores.csv": "Scores of questionnaires, from the answers.",
    "scales.csv": "Computation of these scores, with its publication.",
    "events.csv": "Events of the sessions with their times.",
    "notes.csv": "The experimenters' notes about the person.",
    "adverse_events.csv": "Adverse events with every report.",
    "log.csv": "Views and changes of these data with time and person. Numbers replace the names of experimenters.",
    "recordings/": "Movements of head and hands, robot, forces and answers, in MCAP (https://mcap.dev). Foxglove and "
    "the libraries of MCAP open these files.",
    "codebook.csv": "The description of each column, with unit and allowed values.",
}
"""Description of each file in the archive, by file name, in the order of the index."""


def write_participant_archive(store: StudyStore, pseudonym: str, path: Path) -> int:
    """Write all data of one participant to a new ZIP archive. Returns the number of files.

    Only the user of this process can read the archive.

    Raises:
        StudyError: for an unknown participant, or if the file exists.
        OSError: if the archive cannot be written.
    """
    person = store.read_participant(pseudonym)
    if path.exists():
        raise StudyError(f"{path} exists already; choose another file")
    fetch_recordings(store, pseudonym)
    with TemporaryDirectory(prefix=".avrgym-", dir=path.parent) as temporary:
        folder = Path(temporary) / "files"
        folder.mkdir()
        _write(store, person, folder)
        archive = Path(temporary) / "archive"
        names = _pack(store, person, folder, archive)
        archive.rename(path)
    return len(names)


def _write(store: StudyStore, person: Participant, folder: Path) -> None:
    """Write all files except the recordings and the index."""
    tables = _tables(store, person)
    for name, rows in tables.items():
        write_csv(folder / f"{name}.csv", rows, COLUMNS_BY_TABLE[name])
    write_csv(folder / "codebook.csv", make_codebook_rows(list(tables), store.design))
    write_consent_texts(store, folder)
    named = person.pseudonym in identity_file.read_pseudonyms_with_identity(store.folder)
    identity = identity_file.read_identities(store.folder)[person.pseudonym] if named else None
    contents: dict[str, Any] = {
        "identity": identity and msgspec.to_builtins(identity),
        "inclusion": person.inclusion,
        "functioning": person.functioning,
    }
    for name, values in contents.items():
        if values:
            text = json.dumps(values, indent=1, ensure_ascii=False)
            (folder / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def _tables(store: StudyStore, person: Participant) -> dict[str, Iterable[Any]]:
    attempts = list(list_participant_attempts(store, person))
    completed = [each for each in attempts if each.attempt.state == "completed"]
    answered_items = AnsweredItems(store)
    heights = {each.attempt.id: each.attempt.torso_height_m for each in attempts}
    tables: dict[str, Iterable[Any]] = {
        name: _own(rows, person)
        for name, rows in make_participant_tables(store, attempts, completed, heights, answered_items).items()
    }
    everything, design = ExportOptions(include_free_text=True), answered_items.design
    return {
        **tables,
        "items": make_item_rows(design),
        **({"scales": make_scale_rows(design)} if uses_instruments(design) else {}),
        "events": _own(map(_without_others, make_event_rows(store, [person], everything)), person),
        "notes": make_note_rows(store, [person]),
        "adverse_events": [
            replace(row, recorded_by=None) for row in make_adverse_event_rows(store, [person], everything)
        ],
        "log": _own(make_audit_log_rows(store, DEFAULT_EXPORT_OPTIONS), person),
    }


def _own(rows: Iterable[Any], person: Participant) -> Iterator[Any]:
    return (row for row in rows if row.participant == person.pseudonym)


def _without_others(row: EventRow) -> EventRow:
    return replace(row, detail=None) if row.name in EVENTS_WITH_OTHER_PSEUDONYMS else row


def _pack(store: StudyStore, person: Participant, folder: Path, archive: Path) -> list[str]:
    """Write index, files of a folder and recordings into the archive. Returns all file names."""
    recordings = store.folder / RECORDINGS_FOLDER / person.pseudonym
    files = {path.relative_to(folder).as_posix(): path for path in _files(folder)}
    files |= {
        f"{RECORDINGS_FOLDER}/{path.relative_to(recordings).as_posix()}": path for path in _files(recordings)
    }
    index = _index(store, person, list(files))
    with open(archive, "xb", opener=open_privately) as file, ZipFile(file, "w", ZIP_DEFLATED) as packed:
        packed.writestr(INDEX_FILE, index)
        for name, path in files.items():
            packed.write(path, name)
    return [INDEX_FILE, *files]


def _files(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file() and not path.is_symlink())


def _index(store: StudyStore, person: Participant, names: list[str]) -> str:
    present = [
        (what, words)
        for what, words in FILE_DESCRIPTIONS.items()
        if any(name == what or (what.endswith("/") and name.startswith(what)) for name in names)
    ]
    simulated = (
        ["The participant is simulated: a program generated all data.", ""] if person.simulated else []
    )
    return "\n".join(
        [
            f"# {store.design.title}: the data of {person.pseudonym}",
            "",
            *simulated,
            "This archive contains all data of the study about one person under this number. Regulation (EU) "
            "2016/679 (GDPR) gives them the right to a copy (Article 15), and to receive what they provided in a "
            "common, machine-readable format (Article 20). Tables and recordings have no data of other people.",
            "",
            "| file | contents |",
            "|---|---|",
            *(f"| `{what}` | {words} |" for what, words in present),
            "",
            "Tables are CSV in UTF-8, for any spreadsheet. Times are in UTC.",
            "",
        ]
    )
