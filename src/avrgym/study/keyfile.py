"""The key file: the only place that says who a participant is.

``private/key.json`` in a folder that only its owner may open. Writers hold the study's database as lock.
"""

import os
from pathlib import Path

import msgspec

from avrgym.files import write_whole
from avrgym.study.states import StudyError

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
    """Remove an entry, if there is one."""
    entries = read_key(folder)
    if entries.pop(pseudonym, None) is not None:
        _write(folder, entries)


def _write(folder: Path, entries: dict[str, Identity]) -> None:
    private = folder / FOLDER
    private.mkdir(mode=0o700, exist_ok=True)
    private.chmod(0o700)
    write_whole(private / FILE, msgspec.json.format(msgspec.json.encode(entries)), mode=0o600)


def exposed(folder: Path) -> list[Path]:
    """The private files and folders that others than their owner may use."""
    private = folder / FOLDER
    paths = [private, *private.glob("*")] if private.exists() else []
    return [path for path in paths if os.name == "posix" and path.stat().st_mode & 0o077]
