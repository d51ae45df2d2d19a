"""What a study's folder still tells of its participants where the database is lost."""

from collections.abc import Iterator
from pathlib import Path

from avrgym.study.storage import keyfile
from avrgym.study.storage.rows import RECORDINGS, participant_number
from avrgym.study.storage.seal import HEAD
from avrgym.study.storage.states import StudyError


def remains(folder: Path) -> list[str]:
    """What is there, in words, that only a study with a database leaves."""
    found: list[str] = []
    if keyfile.read_key(folder):
        found.append(f"names in {keyfile.FOLDER}/{keyfile.FILE}")
    if any(path.is_file() for path in (folder / RECORDINGS).rglob("*")):
        found.append(RECORDINGS)
    if (folder / HEAD).exists():
        found.append(HEAD)
    return found


def known_numbers(folder: Path) -> set[int]:
    """The numbers of participants that the key file or the folders of recordings tell of."""
    return set(_numbers([*keyfile.read_key(folder), *_names(folder / RECORDINGS)]))


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def _numbers(pseudonyms: list[str]) -> Iterator[int]:
    for pseudonym in pseudonyms:
        try:
            yield participant_number(pseudonym)
        except StudyError:
            continue
