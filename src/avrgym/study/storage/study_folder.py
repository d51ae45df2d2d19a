"""Find participant data in a study's folder that are not in the database."""

from collections.abc import Iterator
from pathlib import Path

from avrgym.study.storage import identity_file
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER, parse_participant_number
from avrgym.study.storage.integrity_files import HASH_CHAIN_HEAD_FILE
from avrgym.study.storage.participation_list import PARTICIPATION_LIST_FILE as PARTICIPATION
from avrgym.study.storage.participation_list import ParticipationList
from avrgym.study.storage.state_transitions import StudyError


def find_database_traces(folder: Path) -> list[str]:
    """Returns the files and folders that prove an earlier database of the study."""
    found: list[str] = []
    if identity_file.read_pseudonyms_with_identity(folder):
        found.append(f"names in {identity_file.find_identity_file_path(folder).relative_to(folder)}")
    if any(path.is_file() for path in (folder / RECORDINGS_FOLDER).rglob("*")):
        found.append(RECORDINGS_FOLDER)
    found += [name for name in (HASH_CHAIN_HEAD_FILE, PARTICIPATION) if (folder / name).exists()]
    return found


def find_used_participant_numbers(folder: Path) -> set[int]:
    """Returns all participant numbers in the identity file, the participation list and the recordings."""
    listed = ParticipationList(folder).read_entries()
    known = set(
        _numbers([*identity_file.read_pseudonyms_with_identity(folder), *_names(folder / RECORDINGS_FOLDER)])
    )
    return known | {each.participant for each in listed.entries if each.participant} if listed else known


def _names(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def _numbers(pseudonyms: list[str]) -> Iterator[int]:
    for pseudonym in pseudonyms:
        try:
            yield parse_participant_number(pseudonym)
        except StudyError:
            continue
