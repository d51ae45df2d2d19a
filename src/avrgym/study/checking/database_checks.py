"""Check a study's database: changes by other programs, file permissions, and the identity file."""

from collections.abc import Iterator

from avrgym.study.checking.finding import Finding
from avrgym.study.people.identities import find_possible_duplicate_pairs
from avrgym.study.storage import identity_file
from avrgym.study.storage.analysis_files import ANALYSIS_FOLDER as ANALYSIS
from avrgym.study.storage.analysis_files import find_leftover_analysis_folders
from avrgym.study.storage.database import BACKUP_FOLDER
from avrgym.study.storage.database import DATABASE_FILE as DATABASE
from avrgym.study.storage.database_rows import RECORDINGS_FOLDER
from avrgym.study.storage.identity_keys import KeyUnavailableError
from avrgym.study.storage.integrity_files import CHECKSUM_FILE, HASH_CHAIN_HEAD_FILE
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT
from avrgym.study.storage.participation_list import PARTICIPATION_LIST_FILE as PARTICIPATION
from avrgym.study.storage.sites import SITE_DIFFERENCE_EVENT
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE, StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import find_exposed_paths, find_leftover_files, restrict_to_owner

_GONE = ("excluded", "withdrawn", UNKNOWN_PARTICIPATION_STATE)
"""States of participants that no analysis includes."""
_PRIVATE = (
    DATABASE,
    HASH_CHAIN_HEAD_FILE,
    CHECKSUM_FILE,
    PARTICIPATION,
    RECORDINGS_FOLDER,
    BACKUP_FOLDER,
    ANALYSIS,
)


def check_database(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about changes by other programs, damage, rebuilds, and accepted differences between sites."""
    for where, message in store.database.find_integrity_errors():
        yield Finding(where, message)
    for event in store.read_events():
        if event.name == DATABASE_REBUILT_EVENT:
            yield Finding(
                "database",
                f"was rebuilt from the recordings at {event.recorded_at}; {event.detail}",
                is_error=False,
            )
        elif event.name == SITE_DIFFERENCE_EVENT:
            yield Finding("sites", f"were merged although {event.detail}", is_error=False)


def check_private_files(store: StudyStore) -> Iterator[Finding]:
    """Yields findings about file permissions, temporary files and the identity file."""
    for path in find_exposed_paths(store.folder / identity_file.IDENTITY_FOLDER):
        yield Finding(str(path.relative_to(store.folder)), "can be read by other users")
    for name in _PRIVATE:
        others = len(list(find_exposed_paths(store.folder / name)))
        if others:
            message = (
                f"{others} files or folders can be read by other users; --fix-permissions restricts them"
            )
            yield Finding(name, message, is_error=False)
    analysis = store.folder / ANALYSIS
    for path in [
        *identity_file.find_leftover_identity_files(store.folder),
        *find_leftover_files(analysis),
        *find_leftover_analysis_folders(analysis),
    ]:
        yield Finding(
            str(path.relative_to(store.folder)), "is the temporary file of a killed process; remove it"
        )
    yield from _check_names(store)


def _check_names(store: StudyStore) -> Iterator[Finding]:
    states = {participant.pseudonym: participant.state for participant in store.read_participants()}
    where = str(identity_file.find_identity_file_path(store.folder).relative_to(store.folder))
    try:
        named = identity_file.read_pseudonyms_with_identity(store.folder)
    except StudyError as error:
        yield Finding(where, str(error))
        return
    for pseudonym in sorted(named - set(states)):
        yield Finding(
            where,
            f"contains {pseudonym}, who is not in this study; `avrgym study delete-participant` removes the entry",
        )
    yield from _check_encryption(store)
    try:
        key = identity_file.read_identities(store.folder)
    except KeyUnavailableError as error:
        yield Finding(where, f"was not searched for duplicate enrolments: {error}", is_error=False)
        return
    except StudyError as error:
        yield Finding(where, str(error))
        return
    for first, second in find_possible_duplicate_pairs(
        key, (name for name, state in states.items() if state not in _GONE)
    ):
        yield Finding(second, f"may be the same person as {first}: name or contact are equal", is_error=False)


def _check_encryption(store: StudyStore) -> Iterator[Finding]:
    """Yields a finding if the study contains unencrypted names. The message contains the command that encrypts them."""
    plain = identity_file.find_unencrypted_identity_file(store.folder)
    if plain is None:
        return
    where = str(plain.relative_to(store.folder))
    command = f"`avrgym study encrypt-names {store.folder}`"
    if identity_file.read_key_source(store.folder) is None:
        yield Finding(where, f"contains unencrypted names; {command} encrypts them", is_error=False)
    else:
        yield Finding(where, f"is an unencrypted copy of the names; {command} removes it")


def restrict_file_permissions(store: StudyStore) -> None:
    """Give only the owner access to the study's files. Raises ``OSError`` if the system does not allow this."""
    for name in (identity_file.IDENTITY_FOLDER, *_PRIVATE):
        restrict_to_owner(store.folder / name)
