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
from avrgym.study.checking.policy_files import PolicyFile, find_policy_files
from avrgym.study.checking.preflight import find_needed_plugins, find_policy_errors
from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.languages import find_text_files
from avrgym.study.design.toml_validation import read_text
from avrgym.study.plan.analysis_plan import (
    PLAN_FILE,
    AnalysisPlan,
    AvailableTests,
    parse_frozen_analysis_plan,
    read_analysis_plan,
)
from avrgym.study.plan.date_evidence import (
    Registration,
    TimeStamp,
    read_registration,
    read_time_stamp,
)
from avrgym.study.storage.database_rows import (
    RECORDINGS_FOLDER,
    DeletedParticipant,
    Site,
    StudyEvent,
    StudySession,
    format_pseudonym,
)
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_rows, record_event
from avrgym.system.files import PRIVATE_FILE_MODE, write_atomically
from avrgym.system.used_plugins import UsedPlugin
from avrgym.vr.session.attempt import read_package_versions

FROZEN_PLAN_FILE = "plan-frozen.json"
PLAN_FROZEN_EVENT = "plan frozen"
PLAN_ADOPTED_EVENT = "plan adopted"
"""Names of events. The event's detail is the record's SHA-256. An adopted plan was frozen at another station."""
FROZEN_PLAN_FORMAT = "avrgym frozen plan 1"


class FrozenAnalysisPlan(msgspec.Struct, frozen=True):
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

    def parse_plan(self) -> AnalysisPlan:
        """Returns the plan, parsed from its stored text. Raises ``DesignError`` if this version cannot read it."""
        return parse_frozen_analysis_plan(self.plan, FROZEN_PLAN_FILE)


def freeze_analysis_plan(store: StudyStore, available_tests: AvailableTests) -> FrozenAnalysisPlan:
    """Freeze the plan in a study's folder. Returns the record of the frozen plan.

    Args:
        store: the study.
        available_tests: the tests of the study's analysis.

    Raises:
        DesignError: if the plan is invalid.
        StudyError: after the first participant, if a plan is already frozen, or if a policy cannot be loaded.
        OSError: if a file cannot be read or written. Nothing is stored then.
    """
    _, text = read_analysis_plan(store.folder, store.design, available_tests)
    for name, fault in find_policy_errors(store):
        raise StudyError(
            f"nothing was frozen: policy {name}: {fault}; correct the policy file, or policies in study.toml"
        )
    record = _record(store, text)
    data = msgspec.json.format(msgspec.json.encode(record), indent=1) + b"\n"
    path = store.folder / FROZEN_PLAN_FILE
    with store.write_transaction() as connection:
        _check_untouched(store, connection)
        record_event(connection, PLAN_FROZEN_EVENT, compute_sha256(data), {})
        write_atomically(path, data, PRIVATE_FILE_MODE)
    return record


def can_adopt_frozen_plan(store: StudyStore) -> bool:
    """Returns whether the folder contains a frozen plan from another station, without an event in the database."""
    return (store.folder / FROZEN_PLAN_FILE).exists() and not _noted(store)


def adopt_frozen_plan(store: StudyStore) -> FrozenAnalysisPlan:
    """Adopt a frozen plan that was copied from another station: store its checksum. Returns the plan's record.

    Raises:
        StudyError: if the file is not a frozen plan, after the first participant, or after a rebuild of the database.
    """
    data = (store.folder / FROZEN_PLAN_FILE).read_bytes()
    try:
        record = msgspec.json.decode(data, type=FrozenAnalysisPlan)
    except ValueError as error:
        raise StudyError(f"{store.folder / FROZEN_PLAN_FILE} is damaged: {error}; restore a backup") from None
    with store.write_transaction() as connection:
        _check_nobody_took_part(connection)
        record_event(connection, PLAN_ADOPTED_EVENT, compute_sha256(data), {})
    return record


def _noted(store: StudyStore) -> bool:
    with store.database.read_transaction() as connection:
        return any(
            find_rows(connection, StudyEvent, name=name) for name in (PLAN_FROZEN_EVENT, PLAN_ADOPTED_EVENT)
        )


def check_plan_can_be_frozen(store: StudyStore) -> None:
    """Raises ``StudyError`` after the first participant, or if a plan is already frozen."""
    with store.database.read_transaction() as connection:
        _check_untouched(store, connection)


def _check_untouched(store: StudyStore, connection: sa.Connection) -> None:
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
            f"{format_pseudonym(min(taken))} has already taken part; a plan must be frozen before the first "
            f"participant. "
            "Create a new study; do dry runs in a separate folder"
        )


def _record(store: StudyStore, plan: str) -> FrozenAnalysisPlan:
    texts = find_text_files(store.design, store.folder)
    return FrozenAnalysisPlan(
        format=FROZEN_PLAN_FORMAT,
        frozen_at=make_utc_timestamp(),
        sha256={
            name: compute_sha256((store.folder / name).read_bytes()) for name in (PLAN_FILE, DESIGN, *texts)
        },
        versions=read_software_versions(),
        policies=find_policy_files(store),
        plan=plan,
        design=read_text(store.folder / DESIGN),
        texts={name: read_text(store.folder / name) for name in texts},
        plugins=find_needed_plugins(store),
    )


def compute_sha256(data: bytes) -> str:
    """Returns the SHA-256 of the data as hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def read_software_versions() -> dict[str, str]:
    """Returns the versions of AVR Gym, MuJoCo, NumPy and SciPy, by name."""
    return msgspec.structs.asdict(read_package_versions()) | {
        name: version(name) for name in ("numpy", "scipy")
    }


UNKNOWN_TIME_TEXT = "an unknown time"
UNKNOWN_DATE_MESSAGE = (
    "is of unknown date and not confirmatory: its checksum is not in the database. Restore a backup of the database. "
    "Or add a time stamp from before the first participant with `avrgym study freeze DIR --timestamp FILE`"
)


@dataclass(frozen=True)
class FrozenPlanEvidence:
    """A frozen plan, and the evidence for its date.

    ``frozen_plan``: ``None`` if the file cannot be read or was modified. ``error_messages``: error messages about the
    plan. ``existed_since_time``: time at which the database stored the plan's checksum, before the first participant;
    ``None`` if unknown. ``is_adopted``: the plan was frozen at another station. ``database_rebuilt_at``: time of the
    database's rebuild, if any. ``time_stamp``: the plan's time stamp. ``is_date_proven``: a trusted time stamp is
    older than all recordings.
    """

    frozen_plan: FrozenAnalysisPlan | None
    error_messages: tuple[str, ...] = ()
    existed_since_time: str | None = None
    is_adopted: bool = False
    database_rebuilt_at: str | None = None
    time_stamp: TimeStamp | None = None
    is_date_proven: bool = False
    registration: Registration | None = None
    file_sha256: str = ""

    @property
    def is_confirmatory(self) -> bool:
        """Whether the plan certainly existed before the first participant."""
        return self.frozen_plan is not None and (self.existed_since_time is not None or self.is_date_proven)

    @property
    def existed_since_text(self) -> str:
        """The earliest time at which the plan certainly existed, as text; ``UNKNOWN_TIME_TEXT`` if it is unknown."""
        if self.frozen_plan is not None and self.existed_since_time is not None:
            return self.existed_since_time if self.is_adopted else self.frozen_plan.frozen_at
        if self.time_stamp is not None and self.is_date_proven:
            return self.time_stamp.issued_at.isoformat()
        return UNKNOWN_TIME_TEXT

    @property
    def date_evidence_text(self) -> str:
        """Sentences about the plan's date, time stamp and registration."""
        return " ".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        if self.existed_since_time is not None:
            verb = "was stored in the database" if self.is_adopted else "was frozen"
            yield f"The plan {verb} at {_minute(self.existed_since_text)} (UTC), before the first participant."
        elif self.is_date_proven:
            yield f"The plan existed at {_minute(self.existed_since_text)} (UTC), before the first recording."
        else:
            why = (
                f", which was rebuilt at {_minute(self.database_rebuilt_at)} (UTC)"
                if self.database_rebuilt_at
                else ""
            )
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


def read_frozen_plan_evidence(store: StudyStore) -> FrozenPlanEvidence | None:
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
        return FrozenPlanEvidence(None, (fault,)) if noted else None
    data = path.read_bytes()
    own = [each for each in noted if each.detail == compute_sha256(data)]
    if noted and not own:
        fault = "was modified after freezing; restore a backup"
        return FrozenPlanEvidence(None, (fault,))
    try:
        record = msgspec.json.decode(data, type=FrozenAnalysisPlan)
    except ValueError as error:
        return FrozenPlanEvidence(None, (f"is damaged: {error}",))
    rebuilt_at = store.read_database_rebuild_time()
    is_known = len(own) >= max(sites, 1) and rebuilt_at is None
    return _with_evidence(
        store,
        data,
        FrozenPlanEvidence(
            record,
            existed_since_time=max(each.recorded_at for each in own) if is_known else None,
            is_adopted=all(each.name == PLAN_ADOPTED_EVENT for each in own),
            database_rebuilt_at=rebuilt_at,
            file_sha256=compute_sha256(data),
        ),
    )


def _with_evidence(store: StudyStore, data: bytes, frozen: FrozenPlanEvidence) -> FrozenPlanEvidence:
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
    return replace(result, error_messages=tuple(faults))


def _is_before_all(store: StudyStore, moment: datetime) -> bool:
    """Returns whether all recordings began after ``moment``; false if a recording cannot be read."""
    try:
        return all(
            moment < read_header(path).began_at for path in (store.folder / RECORDINGS_FOLDER).rglob("*.mcap")
        )
    except (OSError, RecordingError):
        return False
