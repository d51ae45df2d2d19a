"""Checking a study's database: that only this program wrote its rows, and that nobody else can read its files."""

from collections.abc import Iterator

from avrgym.study.checking.finding import Finding
from avrgym.study.people.identities import possible_duplicates
from avrgym.study.storage import identity_file
from avrgym.study.storage.analysis_files import FOLDER as ANALYSIS
from avrgym.study.storage.analysis_files import unfinished_analyses
from avrgym.study.storage.database import BACKUPS
from avrgym.study.storage.database import FILE as DATABASE
from avrgym.study.storage.identity_keys import KeyUnavailable
from avrgym.study.storage.integrity_files import CHECKSUM, HEAD
from avrgym.study.storage.participation import FILE as PARTICIPATION
from avrgym.study.storage.participation import REBUILT
from avrgym.study.storage.rows import RECORDINGS
from avrgym.study.storage.sites import SITE_DIFFERS
from avrgym.study.storage.states import UNKNOWN, StudyError
from avrgym.study.storage.store import Store
from avrgym.system.files import exposed, make_private, unfinished

_GONE = ("excluded", "withdrawn", UNKNOWN)
"""States of participants whose data enter no analysis."""
_PRIVATE = (DATABASE, HEAD, CHECKSUM, PARTICIPATION, RECORDINGS, BACKUPS, ANALYSIS)


def check_database(store: Store) -> Iterator[Finding]:
    """What was changed from outside or damaged, and from when on that can be told."""
    for where, what in store.database.faults():
        yield Finding(where, what)
    for event in store.events():
        if event.name == REBUILT:
            yield Finding(
                "database", f"was rebuilt from the recordings at {event.at}; {event.detail}", wrong=False
            )
        elif event.name == SITE_DIFFERS:
            yield Finding("sites", f"were merged though {event.detail}", wrong=False)


def check_private(store: Store) -> Iterator[Finding]:
    """Who may read what, and whether names lie where they should not."""
    for path in exposed(store.folder / identity_file.FOLDER):
        yield Finding(str(path.relative_to(store.folder)), "others than its owner may use it")
    for name in _PRIVATE:
        others = len(list(exposed(store.folder / name)))
        if others:
            what = f"others than their owner may use {others} files or folders; --fix-permissions ends that"
            yield Finding(name, what, wrong=False)
    analysis = store.folder / ANALYSIS
    for path in [
        *identity_file.unfinished_files(store.folder),
        *unfinished(analysis),
        *unfinished_analyses(analysis),
    ]:
        yield Finding(str(path.relative_to(store.folder)), "was left by a broken-off write; remove it")
    yield from _check_names(store)


def _check_names(store: Store) -> Iterator[Finding]:
    states = {participant.pseudonym: participant.state for participant in store.participants()}
    where = str(identity_file.identity_path(store.folder).relative_to(store.folder))
    try:
        named = identity_file.named_pseudonyms(store.folder)
    except StudyError as error:
        yield Finding(where, str(error))
        return
    for pseudonym in sorted(named - set(states)):
        yield Finding(where, f"names {pseudonym}, who is not in this study: delete-participant removes that")
    yield from _check_encryption(store)
    try:
        key = identity_file.read_identities(store.folder)
    except KeyUnavailable as error:
        yield Finding(where, f"was not searched for people who take part twice: {error}", wrong=False)
        return
    except StudyError as error:
        yield Finding(where, str(error))
        return
    for first, second in possible_duplicates(
        key, (name for name, state in states.items() if state not in _GONE)
    ):
        yield Finding(
            second, f"may be the same person as {first}, with the same name or contact", wrong=False
        )


def _check_encryption(store: Store) -> Iterator[Finding]:
    """Whether names can be read without a key."""
    plain = identity_file.plain_path(store.folder)
    if plain is None:
        return
    where = str(plain.relative_to(store.folder))
    command = f"`avrgym study encrypt-names {store.folder}`"
    if identity_file.key_source(store.folder) is None:
        yield Finding(where, f"contains names that are not encrypted; {command} encrypts them", wrong=False)
    else:
        yield Finding(where, f"is a copy of names that is not encrypted; {command} removes it")


def fix_permissions(store: Store) -> None:
    """Take a study's data away from everybody but their owner; ``OSError`` where that is not allowed."""
    for name in (identity_file.FOLDER, *_PRIVATE):
        make_private(store.folder / name)
