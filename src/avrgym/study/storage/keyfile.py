"""The key file: the only place that says who a participant is.

``private/key.json`` in a folder that only its owner may open. Writers hold the study's database as lock.
"""

from pathlib import Path

import msgspec

from avrgym.study.storage.states import StudyError
from avrgym.system.files import PRIVATE_FILE, PRIVATE_FOLDER, make_private_folder, write_whole

FOLDER = "private"
FILE = "key.json"


class Identity(msgspec.Struct, frozen=True):
    """Who a participant is."""

    name: str
    contact: str


def read_key(folder: Path) -> dict[str, Identity]:
    """All entries by pseudonym, of the study in ``folder``; ``StudyError`` for a file that is no key."""
    path = folder / FOLDER / FILE
    if not path.exists():
        return {}
    try:
        return msgspec.json.decode(path.read_bytes(), type=dict[str, Identity])
    except msgspec.DecodeError as error:
        raise StudyError(f"{path}: not a key file: {error}") from None


def write_entry(folder: Path, pseudonym: str, identity: Identity) -> None:
    """Add or correct an entry."""
    _write(folder, read_key(folder) | {pseudonym: identity})


def remove_entry(folder: Path, pseudonym: str) -> None:
    """Remove an entry, if there is one, and what a broken-off write left of it."""
    remove_unfinished(folder)
    entries = read_key(folder)
    if entries.pop(pseudonym, None) is not None:
        _write(folder, entries)


def _write(folder: Path, entries: dict[str, Identity]) -> None:
    private = folder / FOLDER
    make_private_folder(private)
    private.chmod(PRIVATE_FOLDER)
    remove_unfinished(folder)
    data = msgspec.json.format(msgspec.json.encode(entries))
    write_whole(private / FILE, data, mode=PRIVATE_FILE)


def unfinished(folder: Path) -> list[Path]:
    """What was left of the key file, with names, where a process was killed that wrote it.

    Only one process writes it at a time, so while the database is locked there is nothing else.
    """
    return sorted((folder / FOLDER).glob(f".{FILE}.*.part"))


def remove_unfinished(folder: Path) -> None:
    """Remove what was left of the key file where a process was killed that wrote it."""
    for path in unfinished(folder):
        path.unlink(missing_ok=True)
