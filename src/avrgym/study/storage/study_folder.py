"""Find participant data in a study's folder that are not in the database."""

from collections.abc import Iterator
from pathlib import Path

from avrgym.study.storage import identity_file
from avrgym.study.storage.integrity_files import CHAIN_HEAD_FILE
from avrgym.study.storage.participation import FILE as PARTICIPATION
from avrgym.study.storage.participation import ParticipationList
from avrgym.study.storage.rows import RECORDINGS, participant_number
from avrgym.study.storage.states import StudyError


def find_database_traces(folder: Path) -> list[str]:
    """Returns the files and folders that prove an earlier database of the study."""
    found: list[str] = []
    if identity_file.pseudonyms_with_identity(folder):
        found.append(f"names in {identity_file.identity_path(folder).relative_to(folder)}")
    if any(path.is_file() for path in (folder / RECORDINGS).rglob("*")):
        found.append(RECORDINGS)
    found += [name for name in (CHAIN_HEAD_FILE, PARTICIPATION) if (folder / name).exists()]
    return found


def used_participant_numbers(folder: Path) -> set[int]:
    """Returns all participant numbers in the identity file, the participation list and the recordings."""
    listed = ParticipationList(folder).read()
    known = set(_numbers([*identity_file.pseudonyms_with_identity(folder), *_names(folder / RECORDINGS)]))
    return known | {each.participant for each in listed.entries if each.participant} if listed else known


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def _numbers(pseudonyms: list[str]) -> Iterator[int]:
    for pseudonym in pseudonyms:
        try:
            yield participant_number(pseudonym)
        except StudyError:
            continue
