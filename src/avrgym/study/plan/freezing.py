"""Freezing a study's plan before the first participant: what the study was at that moment, on record.

``plan-frozen.json`` holds plan, design and all other words of a study with all checksums and versions. Its own checksum
is an event in the database, for which the ledger vouches.
"""

import hashlib
from importlib.metadata import version

import msgspec
import sqlalchemy as sa

from avrgym.study.checking.policy_files import PolicyFile, policy_files
from avrgym.study.checking.preflight import plugins_needed, policy_faults
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.toml import read_text
from avrgym.study.design.word_files import word_files
from avrgym.study.plan.plan import FILE, Offered, Plan, parse_frozen_plan, read_plan
from avrgym.study.storage.participation import REBUILT
from avrgym.study.storage.rows import StudyEvent, StudySession, Tombstone, pseudonym_of
from avrgym.study.storage.schema import now
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all, record_event
from avrgym.system.files import PRIVATE_FILE, write_whole
from avrgym.system.used_plugins import UsedPlugin
from avrgym.vr.session.attempt import versions

FROZEN = "plan-frozen.json"
EVENT = "plan frozen"
ADOPTED = "plan adopted"
"""Their detail is the SHA-256 of the record; a plan is adopted that another station froze."""
FORMAT = "avrgym frozen plan 1"


class Record(msgspec.Struct, frozen=True):
    """What a study was when its plan was frozen.

    ``plan`` and ``design`` are the texts of the files, ``words`` those of the files in which the study has words of its
    own, ``plugins`` those that its trials use; a record of an earlier version has neither.
    """

    format: str
    frozen_at: str
    sha256: dict[str, str]
    versions: dict[str, str]
    policies: tuple[PolicyFile, ...]
    plan: str
    design: str
    words: dict[str, str] | None = None
    plugins: tuple[UsedPlugin, ...] | None = None

    def parsed(self) -> Plan:
        """The plan as it was frozen."""
        return parse_frozen_plan(self.plan, FROZEN)


def freeze(store: Store, offered: Offered) -> Record:
    """Freeze the plan in a study's folder.

    Args:
        store: the study.
        offered: the tests that its analysis does.

    Raises:
        DesignError: when the plan says what cannot be.
        StudyError: when somebody has taken part, a plan was frozen before, or a policy cannot be used.
        OSError: when plan or record cannot be read or written. Nothing is stored then.
    """
    _, text = read_plan(store.folder, store.design, offered)
    for name, fault in policy_faults(store):
        raise StudyError(f"nothing was frozen: policy {name}: {fault}")
    record = _record(store, text)
    data = msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"
    path = store.folder / FROZEN
    with store.write() as connection:
        _check_untouched(store, connection)
        record_event(connection, EVENT, sha256(data), {})
        write_whole(path, data, PRIVATE_FILE)
    return record


def may_adopt(store: Store) -> bool:
    """Whether there is a frozen plan, copied from another station, that the database does not know."""
    return (store.folder / FROZEN).exists() and not _noted(store)


def adopt(store: Store) -> Record:
    """Store the checksum of a frozen plan that was copied from another station.

    Raises:
        StudyError: when it is no frozen plan, somebody has taken part, or the database was rebuilt.
    """
    data = (store.folder / FROZEN).read_bytes()
    try:
        record = msgspec.json.decode(data, type=Record)
    except ValueError as error:
        raise StudyError(f"{store.folder / FROZEN} is damaged: {error}; put a copy back") from None
    with store.write() as connection:
        _check_nobody_took_part(connection)
        record_event(connection, ADOPTED, sha256(data), {})
    return record


def _noted(store: Store) -> bool:
    with store.database.read() as connection:
        return any(find_all(connection, StudyEvent, name=name) for name in (EVENT, ADOPTED))


def check_untouched(store: Store) -> None:
    """Raise ``StudyError`` unless a plan can still be frozen: none is, and nobody has taken part."""
    with store.database.read() as connection:
        _check_untouched(store, connection)


def _check_untouched(store: Store, connection: sa.Connection) -> None:
    if (store.folder / FROZEN).exists() or find_all(connection, StudyEvent, name=EVENT):
        raise StudyError(
            f"the plan of {store.folder} is frozen already; `avrgym study status` lists deviations"
        )
    _check_nobody_took_part(connection)


def _check_nobody_took_part(connection: sa.Connection) -> None:
    for event in find_all(connection, StudyEvent, name=REBUILT):
        raise StudyError(
            f"the database was rebuilt at {event.at}: earlier participants are unknown, so a plan frozen now would "
            "confirm nothing; put back a copy of the database, or create a new study"
        )
    taken = [each.participant for each in find_all(connection, StudySession)]
    taken += [each.number for each in find_all(connection, Tombstone)]
    if taken:
        raise StudyError(
            f"{pseudonym_of(min(taken))} has taken part already: a plan is made before the first participant; "
            "this study stays one without a plan (dry runs belong in a folder of their own)"
        )


def _record(store: Store, plan: str) -> Record:
    words = word_files(store.design, store.folder)
    return Record(
        format=FORMAT,
        frozen_at=now(),
        sha256={name: sha256((store.folder / name).read_bytes()) for name in (FILE, DESIGN, *words)},
        versions=software(),
        policies=policy_files(store),
        plan=plan,
        design=read_text(store.folder / DESIGN),
        words={name: read_text(store.folder / name) for name in words},
        plugins=plugins_needed(store),
    )


def sha256(data: bytes) -> str:
    """A checksum, as ``sha256sum`` prints it."""
    return hashlib.sha256(data).hexdigest()


def software() -> dict[str, str]:
    """The versions of what simulates and of what computes the analysis."""
    return versions() | {name: version(name) for name in ("numpy", "scipy")}
