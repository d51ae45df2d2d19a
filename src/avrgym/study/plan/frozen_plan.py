"""Freeze the plan of a study before the first participant, and prove its date.

``plan-frozen.json`` contains plan, design and texts with all checksums and versions. The database contains an event
with the file's SHA-256. The plan is confirmatory in two cases. First: this event is before the first session, and the
database was not rebuilt. Second: a trusted time stamp is older than all recordings. Otherwise, all results are
exploratory.
"""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime
from importlib.metadata import version

import msgspec
import sqlalchemy as sa

from avrgym.recording.reader import RecordingError, read_header
from avrgym.study.checking.policy_files import PolicyFile, policy_files
from avrgym.study.checking.preflight import needed_plugins, policy_errors
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.languages import text_files
from avrgym.study.design.validation import read_text
from avrgym.study.plan.plan import FILE, AvailableTests, Plan, parse_frozen_plan, read_plan
from avrgym.study.plan.timestamps import (
    Registration,
    TimeStamp,
    read_registration,
    read_time_stamp,
)
from avrgym.study.storage.participation import DATABASE_REBUILT_EVENT
from avrgym.study.storage.rows import (
    RECORDINGS,
    DeletedParticipant,
    Site,
    StudyEvent,
    StudySession,
    pseudonym_of,
)
from avrgym.study.storage.schema import utc_timestamp
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_rows, record_event
from avrgym.system.files import PRIVATE_FILE_MODE, write_atomically
from avrgym.system.used_plugins import UsedPlugin
from avrgym.vr.session.attempt import versions

FROZEN_PLAN_FILE = "plan-frozen.json"
PLAN_FROZEN_EVENT = "plan frozen"
PLAN_ADOPTED_EVENT = "plan adopted"
"""Names of events. The event's detail is the record's SHA-256. An adopted plan was frozen at another station."""
FROZEN_PLAN_FORMAT = "avrgym frozen plan 1"


class FrozenPlanRecord(msgspec.Struct, frozen=True):
    """The plan and the study at the time of freezing.

    ``plan`` and ``design``: texts of these files. ``texts``: the study's text files. ``plugins``: plug-ins of the
    study's trials. Records of earlier versions have no ``texts`` and ``plugins``.
    """

    format: str
    frozen_at: str
    sha256: dict[str, str]
    versions: dict[str, str]
    policies: tuple[PolicyFile, ...]
    plan: str
    design: str
    texts: dict[str, str] | None = msgspec.field(default=None, name="words")
    plugins: tuple[UsedPlugin, ...] | None = None

    def parsed_plan(self) -> Plan:
        """Returns the plan, parsed from its stored text. Raises ``DesignError`` if this version cannot read it."""
        return parse_frozen_plan(self.plan, FROZEN_PLAN_FILE)


def freeze_plan(store: Store, available_tests: AvailableTests) -> FrozenPlanRecord:
    """Freeze the plan in a study's folder. Returns the record of the frozen plan.

    Args:
        store: the study.
        available_tests: the tests of the study's analysis.

    Raises:
        DesignError: if the plan is invalid.
        StudyError: after the first participant, if a plan is already frozen, or if a policy cannot be loaded.
        OSError: if a file cannot be read or written. Nothing is stored then.
    """
    _, text = read_plan(store.folder, store.design, available_tests)
    for name, fault in policy_errors(store):
        raise StudyError(
            f"nothing was frozen: policy {name}: {fault}; correct the policy file, or policies in study.toml"
        )
    record = _record(store, text)
    data = msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"
    path = store.folder / FROZEN_PLAN_FILE
    with store.write_transaction() as connection:
        _check_untouched(store, connection)
        record_event(connection, PLAN_FROZEN_EVENT, sha256(data), {})
        write_atomically(path, data, PRIVATE_FILE_MODE)
    return record


def can_adopt_plan(store: Store) -> bool:
    """Returns whether the folder contains a frozen plan from another station, without an event in the database."""
    return (store.folder / FROZEN_PLAN_FILE).exists() and not _noted(store)


def adopt_plan(store: Store) -> FrozenPlanRecord:
    """Adopt a frozen plan that was copied from another station: store its checksum. Returns the plan's record.

    Raises:
        StudyError: if the file is not a frozen plan, after the first participant, or after a rebuild of the database.
    """
    data = (store.folder / FROZEN_PLAN_FILE).read_bytes()
    try:
        record = msgspec.json.decode(data, type=FrozenPlanRecord)
    except ValueError as error:
        raise StudyError(f"{store.folder / FROZEN_PLAN_FILE} is damaged: {error}; restore a backup") from None
    with store.write_transaction() as connection:
        _check_nobody_took_part(connection)
        record_event(connection, PLAN_ADOPTED_EVENT, sha256(data), {})
    return record


def _noted(store: Store) -> bool:
    with store.database.read_transaction() as connection:
        return any(
            find_rows(connection, StudyEvent, name=name) for name in (PLAN_FROZEN_EVENT, PLAN_ADOPTED_EVENT)
        )


def check_can_freeze(store: Store) -> None:
    """Raises ``StudyError`` after the first participant, or if a plan is already frozen."""
    with store.database.read_transaction() as connection:
        _check_untouched(store, connection)


def _check_untouched(store: Store, connection: sa.Connection) -> None:
    if (store.folder / FROZEN_PLAN_FILE).exists() or find_rows(
        connection, StudyEvent, name=PLAN_FROZEN_EVENT
    ):
        raise StudyError(
            f"the plan of {store.folder} is frozen already; `avrgym study status` lists deviations"
        )
    _check_nobody_took_part(connection)


def _check_nobody_took_part(connection: sa.Connection) -> None:
    for event in find_rows(connection, StudyEvent, name=DATABASE_REBUILT_EVENT):
        raise StudyError(
            f"the plan cannot be frozen: the database was rebuilt at {event.recorded_at}, and earlier participants are "
            "unknown. Restore a backup of the database, or create a new study"
        )
    taken = [each.participant for each in find_rows(connection, StudySession)]
    taken += [each.number for each in find_rows(connection, DeletedParticipant)]
    if taken:
        raise StudyError(
            f"{pseudonym_of(min(taken))} has already taken part; a plan must be frozen before the first participant. "
            "Create a new study; do dry runs in a separate folder"
        )


def _record(store: Store, plan: str) -> FrozenPlanRecord:
    texts = text_files(store.design, store.folder)
    return FrozenPlanRecord(
        format=FROZEN_PLAN_FORMAT,
        frozen_at=utc_timestamp(),
        sha256={name: sha256((store.folder / name).read_bytes()) for name in (FILE, DESIGN, *texts)},
        versions=software_versions(),
        policies=policy_files(store),
        plan=plan,
        design=read_text(store.folder / DESIGN),
        texts={name: read_text(store.folder / name) for name in texts},
        plugins=needed_plugins(store),
    )


def sha256(data: bytes) -> str:
    """Returns the SHA-256 of the data as hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def software_versions() -> dict[str, str]:
    """Returns the versions of AVR Gym, MuJoCo, NumPy and SciPy, by name."""
    return msgspec.structs.asdict(versions()) | {name: version(name) for name in ("numpy", "scipy")}


UNKNOWN_TIME_TEXT = "an unknown time"
UNKNOWN_DATE_MESSAGE = (
    "is of unknown date and not confirmatory: its checksum is not in the database. Restore a backup of the database. "
    "Or add a time stamp from before the first participant with `avrgym study freeze DIR --timestamp FILE`"
)


@dataclass(frozen=True)
class FrozenPlan:
    """A frozen plan, and the evidence for its date.

    ``record``: ``None`` if the file cannot be read or was modified. ``faults``: error messages about the plan.
    ``existed_since``: time at which the database stored the plan's checksum, before the first participant; ``None`` if
    unknown. ``is_adopted``: the plan was frozen at another station. ``rebuilt_at``: time of the database's rebuild, if
    any. ``time_stamp``: the plan's time stamp. ``is_date_proven``: a trusted time stamp is older than all recordings.
    """

    record: FrozenPlanRecord | None
    faults: tuple[str, ...] = ()
    existed_since: str | None = None
    is_adopted: bool = False
    rebuilt_at: str | None = None
    time_stamp: TimeStamp | None = None
    is_date_proven: bool = False
    registration: Registration | None = None
    sha256: str = ""

    @property
    def is_confirmatory(self) -> bool:
        """Whether the plan certainly existed before the first participant."""
        return self.record is not None and (self.existed_since is not None or self.is_date_proven)

    @property
    def existed_since_text(self) -> str:
        """The earliest time at which the plan certainly existed, as text; ``UNKNOWN_TIME_TEXT`` if it is unknown."""
        if self.record is not None and self.existed_since is not None:
            return self.existed_since if self.is_adopted else self.record.frozen_at
        if self.time_stamp is not None and self.is_date_proven:
            return self.time_stamp.issued_at.isoformat()
        return UNKNOWN_TIME_TEXT

    @property
    def origin_text(self) -> str:
        """Sentences about the plan's date, time stamp and registration."""
        return " ".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        if self.existed_since is not None:
            verb = "was stored in the database" if self.is_adopted else "was frozen"
            yield f"The plan {verb} at {_minute(self.existed_since_text)} (UTC), before the first participant."
        elif self.is_date_proven:
            yield f"The plan existed at {_minute(self.existed_since_text)} (UTC), before the first recording."
        else:
            why = f", which was rebuilt at {_minute(self.rebuilt_at)} (UTC)" if self.rebuilt_at else ""
            yield (
                f"The date of the plan is unknown: its checksum is not in the database{why}. "
                "It is not confirmatory; all results are exploratory."
            )
        if self.time_stamp is not None:
            known = "knows" if self.time_stamp.is_trusted else "does not know"
            proves = "" if self.time_stamp.is_trusted else ", so the time stamp alone proves nothing"
            at = _minute(self.time_stamp.issued_at.isoformat())
            yield (
                f"A valid time stamp (RFC 3161) of {self.time_stamp.authority} gives {at} (UTC); this "
                f"computer {known} the root certificate of that authority{proves}."
            )
        if self.registration is not None:
            claim = self.registration
            yield f"The researchers claim a registration of {claim.registered_on} at {claim.url}; this is not verified."


def _minute(at: str) -> str:
    """Returns an ISO 8601 time stamp, truncated to the minute."""
    return at[:16].replace("T", " ")


def read_frozen_plan(store: Store) -> FrozenPlan | None:
    """Returns the frozen plan of a study; ``None`` if there is none."""
    path = store.folder / FROZEN_PLAN_FILE
    with store.database.read_transaction() as connection:
        noted = [
            each
            for name in (PLAN_FROZEN_EVENT, PLAN_ADOPTED_EVENT)
            for each in find_rows(connection, StudyEvent, name=name)
        ]
        sites = len(find_rows(connection, Site))
    if not path.exists():
        fault = "is missing; restore a backup"
        return FrozenPlan(None, (fault,)) if noted else None
    data = path.read_bytes()
    own = [each for each in noted if each.detail == sha256(data)]
    if noted and not own:
        fault = "was modified after freezing; restore a backup"
        return FrozenPlan(None, (fault,))
    try:
        record = msgspec.json.decode(data, type=FrozenPlanRecord)
    except ValueError as error:
        return FrozenPlan(None, (f"is damaged: {error}",))
    rebuilt_at = store.rebuilt_at()
    is_known = len(own) >= max(sites, 1) and rebuilt_at is None
    return _with_evidence(
        store,
        data,
        FrozenPlan(
            record,
            existed_since=max(each.recorded_at for each in own) if is_known else None,
            is_adopted=all(each.name == PLAN_ADOPTED_EVENT for each in own),
            rebuilt_at=rebuilt_at,
            sha256=sha256(data),
        ),
    )


def _with_evidence(store: Store, data: bytes, frozen: FrozenPlan) -> FrozenPlan:
    """Returns the frozen plan with its time stamp, registration and errors."""
    faults: list[str] = []
    stamp, registration = None, None
    try:
        stamp = read_time_stamp(store.folder, data)
    except StudyError as error:
        faults.append(f"has an invalid time stamp: {error}")
    try:
        registration = read_registration(store.folder)
    except StudyError as error:
        faults.append(str(error))
    is_proven = stamp is not None and stamp.is_trusted and _is_before_all(store, stamp.issued_at)
    result = replace(frozen, time_stamp=stamp, registration=registration, is_date_proven=is_proven)
    if not result.is_confirmatory:
        faults.insert(0, UNKNOWN_DATE_MESSAGE)
    return replace(result, faults=tuple(faults))


def _is_before_all(store: Store, moment: datetime) -> bool:
    """Returns whether all recordings began after ``moment``; false if a recording cannot be read."""
    try:
        return all(
            moment < read_header(path).began_at for path in (store.folder / RECORDINGS).rglob("*.mcap")
        )
    except (OSError, RecordingError):
        return False
