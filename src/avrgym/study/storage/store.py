"""Open a study (its folder and its database), and read its rows."""

import os
import socket
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, Self, TypeVar, cast, get_type_hints

import msgspec
import sqlalchemy as sa

from avrgym.policies.onnx import ONNX_SUFFIX
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.policies.registry import list_policy_names
from avrgym.policies.trained_policies import POLICY_FILE_SUFFIX, PolicyError
from avrgym.study.design.design import DESIGN_FILE, Design, read_default_design_text, read_design
from avrgym.study.design.design_comparison import design_to_dict, read_design_texts
from avrgym.study.storage import hash_chain, identity_file, schema
from avrgym.study.storage.database import DATABASE_FILE as DATABASE_FILE
from avrgym.study.storage.database import StudyDatabase, find_database_url
from avrgym.study.storage.database_rows import (
    RECORDINGS_FOLDER,
    AdverseEventReport,
    AuditLogEntry,
    ConsentRecord,
    ConsentText,
    DeletedParticipant,
    Experimenter,
    ExperimenterNote,
    Invitation,
    InvitationUse,
    Participant,
    Site,
    StoredDesign,
    StoredSessionLink,
    StudyAnswer,
    StudyEvent,
    StudySession,
    Trial,
    TrialAttempt,
    parse_participant_number,
)
from avrgym.study.storage.object_store import ObjectStore, open_object_store
from avrgym.study.storage.participation_list import DATABASE_REBUILT_EVENT, ParticipationEntries
from avrgym.study.storage.participation_list import PARTICIPATION_LIST_FILE as PARTICIPATION
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import TRANSITIONS_BY_TABLE, StudyError, check_transition
from avrgym.system.files import make_private_folder, write_private_file
from avrgym.tasks.registry import find_environment

Row = TypeVar("Row")
T = TypeVar("T")
TABLES_BY_ROW_TYPE: Mapping[type, sa.Table] = {
    Participant: schema.PARTICIPANT_TABLE,
    StudySession: schema.SESSION_TABLE,
    StoredDesign: schema.DESIGN_TABLE,
    Trial: schema.TRIAL_TABLE,
    TrialAttempt: schema.ATTEMPT_TABLE,
    StudyAnswer: schema.ANSWER_TABLE,
    StudyEvent: schema.EVENT_TABLE,
    ExperimenterNote: schema.NOTE_TABLE,
    AdverseEventReport: schema.ADVERSE_EVENT_TABLE,
    ConsentText: schema.CONSENT_TEXT_TABLE,
    ConsentRecord: schema.CONSENT_TABLE,
    StoredSessionLink: schema.SESSION_LINK_TABLE,
    DeletedParticipant: schema.TOMBSTONE_TABLE,
    Site: schema.SITE_TABLE,
    Experimenter: schema.EXPERIMENTER_TABLE,
    AuditLogEntry: schema.AUDIT_LOG_TABLE,
    Invitation: schema.INVITATION_TABLE,
    InvitationUse: schema.INVITATION_USE_TABLE,
}


def create_study(folder: Path) -> Path:
    """Write ``study.toml`` with the paper's protocol into a folder. Returns the file's path.

    A missing folder is created.

    Raises:
        StudyError: if the folder already contains files of a study. Nothing is changed then.
        OSError: if the file cannot be written.
    """
    names = (DESIGN_FILE, DATABASE_FILE, PARTICIPATION, RECORDINGS_FOLDER, identity_file.IDENTITY_FOLDER)
    present = [name for name in names if (folder / name).exists()]
    if present:
        raise StudyError(f"{folder} contains {present[0]} already; choose another folder")
    make_private_folder(folder)
    path = folder / DESIGN_FILE
    write_private_file(path, read_default_design_text())
    return path


class StudyStore:
    """An open study. Its methods read rows; the packages ``people`` and ``sessions`` change rows.

    ``folder``: the study's folder. ``station_name``: name of this computer. ``object_store``: contains copies of the
    recordings; ``None`` if the study has none. ``is_temporary``: the folder is a temporary copy; the end of an attempt
    is stored only after its recording was uploaded. A study in a read-only folder can be read. Methods are thread-safe.
    """

    def __init__(self, folder: Path, *, rebuild: bool = False, temporary: bool = False) -> None:
        """Open the study in a folder.

        Args:
            folder: the study's folder.
            rebuild: create a new database even if an earlier one was lost.
            temporary: see ``is_temporary``.

        Raises:
            DesignError: if ``study.toml`` is invalid.
            StudyError: if the folder contains no study, or if its database was lost or has another version.
        """
        if not (folder / DESIGN_FILE).is_file():
            raise StudyError(f"{folder} contains no {DESIGN_FILE}; `avrgym study new {folder}` creates it")
        self.folder = folder.resolve()
        self.station_name = socket.gethostname()
        self.design: Design = read_design(folder / DESIGN_FILE)
        self.object_store: ObjectStore | None = open_object_store(self.design.recordings.url)
        self.is_temporary = temporary
        url = find_database_url(self.design.database.url)
        self.database = StudyDatabase(
            self.folder, url, read_only=not _can_write(self.folder), rebuild=rebuild
        )
        try:
            self._check_protocol()
            if not rebuild:
                self.database.reconcile_participation()
            if identity_file.find_leftover_identity_files(self.folder) and not self.database.is_read_only:
                with self.database.write_transaction():  # one writer at a time, for the identity file as well
                    identity_file.remove_leftover_identity_files(self.folder)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the study's database, and store its checksum."""
        self.database.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @contextmanager
    def write_transaction(self) -> Generator[sa.Connection]:
        """Context manager: a write transaction. Raises ``StudyError`` in a merged study."""
        with self.database.write_transaction() as connection:
            if find_rows(connection, Site):
                raise StudyError(
                    f"{self.folder} was merged from sites: change the study of the site, then merge again"
                )
            yield connection

    def resolve_path(self, relative: str) -> Path:
        """Returns the absolute path of a file in the study.

        Raises ``StudyError`` if the path, or the target of a symbolic link, is outside the study's folder.
        """
        path = self.folder / relative
        if not path.resolve().is_relative_to(self.folder):
            raise StudyError(f"{relative!r} is outside the study's folder; allowed: paths inside it")
        return path

    def find_policy_source(self, environment: str, policy: str) -> str:
        """Returns the source of a policy: its file in the study's folder; without a file, its name.

        ``policy``: name of a policy or condition in the design. A condition has the source of its policy.

        Raises:
            PolicyError: if there is neither a file nor a policy with this name.
        """
        policy = self.design.find_condition_policy(policy)
        task, robot = find_environment(environment)
        own = [f"{policy}/{task}{robot}{suffix}" for suffix in (ONNX_SUFFIX, POLICY_FILE_SUFFIX)]
        for file in own:
            if (self.folder / file).is_file():
                return str(self.folder / file)
        names = [*list_policy_names(environment), OPERATOR_POLICY_NAME]
        if policy not in names and ":" not in policy:
            raise PolicyError(
                f"no policy {policy!r} for {environment}; allowed: {', '.join(names)}, MODULE:ATTRIBUTE, "
                f"lerobot:FOLDER, or the study's own as {' or '.join(own)} in its folder"
            )
        return policy

    def read_participants(self) -> list[Participant]:
        """Returns all participants, ordered by number."""
        return self._rows(Participant)

    def read_participant(self, pseudonym: str) -> Participant:
        """Returns the participant with a pseudonym. Raises ``StudyError`` for an unknown pseudonym."""
        with self.database.read_transaction() as connection:
            return find_participant(connection, pseudonym)

    def read_sessions(self, pseudonym: str) -> list[StudySession]:
        """Returns a participant's sessions, ordered by number."""
        return self._rows(StudySession, participant=parse_participant_number(pseudonym))

    def read_stored_designs(self) -> list[StoredDesign]:
        """Returns all stored designs: at the start of sessions, and at the inclusion of participants."""
        return self._rows(StoredDesign)

    def read_trials(self, pseudonym: str) -> list[Trial]:
        """Returns a participant's trials, ordered by position."""
        return self._rows(Trial, participant=parse_participant_number(pseudonym))

    def read_remaining_trials(self, pseudonym: str) -> list[Trial]:
        """Returns a participant's planned trials, followed by the skipped trials."""
        trials = self.read_trials(pseudonym)
        return [trial for state in ("planned", "skipped") for trial in trials if trial.state == state]

    def read_attempts(self, pseudonym: str) -> list[TrialAttempt]:
        """Returns all attempts at a participant's trials, in the order of their start times."""
        return self._rows(TrialAttempt, session=self._session_ids(pseudonym))

    def read_answers(self, pseudonym: str) -> list[StudyAnswer]:
        """Returns all answers about a participant's sessions and trials, in the order of storage."""
        return self._rows(StudyAnswer, session=self._session_ids(pseudonym))

    def read_events(self) -> list[StudyEvent]:
        """Returns all events of the study, in the order of storage."""
        return self._rows(StudyEvent)

    def read_session_events(self, pseudonym: str) -> list[StudyEvent]:
        """Returns the events of all sessions of a participant, in the order of sessions and storage."""
        sessions = self.read_sessions(pseudonym)
        return [event for each in sessions for event in self._rows(StudyEvent, session=each.id)]

    def read_participation_list(self) -> ParticipationEntries | None:
        """Returns the contents of the participation list; ``None`` if the file does not exist."""
        return self.database.participation_list.read_entries()

    def read_database_rebuild_time(self) -> str | None:
        """Returns the time of the first rebuild of the database; ``None`` if it was never rebuilt."""
        return next(
            (event.recorded_at for event in self.read_events() if event.name == DATABASE_REBUILT_EVENT), None
        )

    def read_notes(self, pseudonym: str) -> list[ExperimenterNote]:
        """Returns the experimenters' notes about a participant, in the order of storage."""
        return self._rows(ExperimenterNote, participant=parse_participant_number(pseudonym))

    def read_adverse_event_reports(self, pseudonym: str) -> list[AdverseEventReport]:
        """Returns all reports of a participant's adverse events, in the order of storage."""
        return self._rows(AdverseEventReport, participant=parse_participant_number(pseudonym))

    def read_consents(self, pseudonym: str) -> list[ConsentRecord]:
        """Returns all decisions of a participant about consent texts, in the order of storage."""
        return self._rows(ConsentRecord, participant=parse_participant_number(pseudonym))

    def read_consent_texts(self) -> list[ConsentText]:
        """Returns all stored consent texts, in the order of their first use."""
        return self._rows(ConsentText)

    def read_deleted_participants(self) -> list[DeletedParticipant]:
        """Returns the participants with deleted data."""
        return self._rows(DeletedParticipant)

    def read_audit_log(self) -> list[AuditLogEntry]:
        """Returns all entries of the audit log, in the order of storage."""
        return self._rows(AuditLogEntry)

    def read_sites(self) -> list[Site]:
        """Returns the sites of a merged study; empty for a study that is not merged."""
        return self._rows(Site)

    def _session_ids(self, pseudonym: str) -> tuple[int, ...]:
        return tuple(session.id for session in self.read_sessions(pseudonym))

    def _rows(self, kind: type[Row], **key: int | tuple[int, ...]) -> list[Row]:
        with self.database.read_transaction() as connection:
            return find_rows(connection, kind, **key)

    def _check_protocol(self) -> None:
        """Store the design fields that determine trial orders.

        Raises ``StudyError`` if these fields changed after the first participant was allocated.
        """
        protocol = self.design.list_fixed_field_values()
        with self.database.read_transaction() as connection:
            stored = connection.execute(sa.select(schema.STUDY_TABLE.c.protocol)).scalar()
        if stored != protocol and not (stored is None and self.database.is_read_only):
            with self.database.write_transaction() as connection:
                self._change_protocol(connection, protocol)

    def _change_protocol(self, connection: sa.Connection, protocol: dict[str, Any]) -> None:
        stored: dict[str, Any] = connection.execute(sa.select(schema.STUDY_TABLE.c.protocol)).scalar() or {}
        if stored == protocol:
            return
        changed = [name for name in {**stored, **protocol} if stored.get(name) != protocol.get(name)]
        taken = sa.select(schema.PARTICIPANT_TABLE.c.number).where(
            schema.PARTICIPANT_TABLE.c.cell.is_not(None)
        )
        if stored and connection.execute(taken.limit(1)).first():
            raise StudyError(
                f"{self.folder / DESIGN_FILE}: {', '.join(changed)} changed after the first participant was allocated; "
                f"allowed: the earlier value {stored.get(changed[0], {})!r}"
            )
        hash_chain.delete_rows(connection, schema.STUDY_TABLE)
        hash_chain.insert_row(
            connection, schema.STUDY_TABLE, created_at=make_utc_timestamp(), protocol=protocol
        )


def _can_write(folder: Path) -> bool:
    database = folder / DATABASE_FILE
    return os.access(folder, os.W_OK) and (not database.exists() or os.access(database, os.W_OK))


def find_row(connection: sa.Connection, kind: type[Row], what: str, **key: int) -> Row:
    """Returns the first row with the column values ``key``.

    Raises ``StudyError`` if no row has these values. ``what``: name of the row in the message.
    """
    rows = find_rows(connection, kind, **key)
    if not rows:
        raise StudyError(f"there is no {what} in this study; `avrgym study status` lists its participants")
    return rows[0]


def find_participant(connection: sa.Connection, pseudonym: str) -> Participant:
    """Returns the participant with this pseudonym. Raises ``StudyError`` for an unknown pseudonym."""
    return find_row(connection, Participant, pseudonym, number=parse_participant_number(pseudonym))


def find_session(connection: sa.Connection, session_id: int) -> StudySession:
    """Returns the session with this id. Raises ``StudyError`` for an unknown id."""
    return find_row(connection, StudySession, f"session {session_id}", id=session_id)


def find_open_session(connection: sa.Connection, session_id: int) -> StudySession:
    """Returns the session with this id. Raises ``StudyError`` if it is not open."""
    session = find_session(connection, session_id)
    if session.state != "open":
        raise StudyError(f"{session} is {session.state}; allowed: an open session")
    return session


def find_running_attempt(connection: sa.Connection, attempt_id: int) -> TrialAttempt:
    """Returns the attempt with this id. Raises ``StudyError`` if it is not running."""
    attempt = find_row(connection, TrialAttempt, f"attempt {attempt_id}", id=attempt_id)
    if attempt.state != "running":
        raise StudyError(f"{attempt} is {attempt.state}; allowed: a running attempt")
    return attempt


def find_trial(connection: sa.Connection, session: StudySession, position: int) -> Trial:
    """Returns the trial at a position of the trial order of the session's participant."""
    own = {"participant": session.participant, "position": position}
    return find_row(connection, Trial, f"trial {position}", **own)


def find_rows(connection: sa.Connection, kind: type[Row], **key: Any) -> list[Row]:
    """Returns all rows with the column values ``key``, ordered by primary key. A tuple contains the allowed values.

    Raises ``StudyError`` if a row is damaged.
    """
    table = TABLES_BY_ROW_TYPE[kind]
    names = _columns(kind)
    query = sa.select(*(table.c[name] for name in names))
    query = query.where(
        *(
            table.c[name].in_(cast(tuple[Any, ...], value))
            if isinstance(value, tuple)
            else table.c[name] == value
            for name, value in key.items()
        )
    )
    try:
        rows = connection.execute(query.order_by(hash_chain.find_primary_key_column(table))).all()
        return [_as(kind, dict(zip(names, row, strict=True))) for row in rows]
    except ValueError as error:
        raise StudyError(
            f"the study's database: a row of {table.name} is damaged: {error}; restore a backup"
        ) from error


@cache
def _columns(kind: type) -> tuple[str, ...]:
    return tuple(get_type_hints(kind))


def change_state(
    connection: sa.Connection,
    row: Any,
    after: str,
    subject: Mapping[str, int],
    detail: str = "",
    **values: Any,
) -> None:
    """Change the state and other values of a row, and store an event.

    Args:
        connection: a write transaction.
        row: the row.
        after: the new state.
        subject: ids of participant, session and attempt for the event.
        detail: detail of the event.
        values: further columns to change.

    Raises:
        StudyError: if the transition is not allowed.
    """
    table = TABLES_BY_ROW_TYPE[type(row)]
    key = getattr(row, hash_chain.find_primary_key_column(table).name)
    own = hash_chain.find_primary_key_column(table) == key
    before = connection.execute(sa.select(table.c.state).where(own)).scalar_one()
    check_transition(table.name, str(row), before, after)
    hash_chain.update_row(connection, table, key, state=after, **values)
    record_event(connection, f"{table.name} {after}", detail, subject)


def make_event_subject(session: StudySession) -> dict[str, int]:
    """Returns the ids of participant and session for an event in a session."""
    return {"participant": session.participant, "session": session.id}


def store_design(store: StudyStore, connection: sa.Connection, subject: Mapping[str, int]) -> None:
    """Store the current design. ``subject``: ids of the participant, and of the session that starts."""
    hash_chain.insert_row(
        connection,
        schema.DESIGN_TABLE,
        stored_at=make_utc_timestamp(),
        design=design_to_dict(store.design),
        wordings=read_design_texts(store.design, store.folder),
        **subject,
    )


def record_event(connection: sa.Connection, name: str, detail: str, subject: Mapping[str, int]) -> None:
    """Store an event. ``subject``: ids of the event's participant, session and attempt; each id is optional."""
    hash_chain.insert_row(
        connection, schema.EVENT_TABLE, recorded_at=make_utc_timestamp(), name=name, detail=detail, **subject
    )


def read_latest_event_value(store: StudyStore, pseudonym: str, name: str, kind: type[T]) -> T | None:
    """Returns the value in a participant's latest event with this name; ``None`` without such an event.

    ``kind``: type of the value, which the event stores as JSON.

    Raises:
        StudyError: if the stored value is damaged.
    """
    with store.database.read_transaction() as connection:
        events = find_rows(connection, StudyEvent, participant=parse_participant_number(pseudonym), name=name)
    if not events:
        return None
    try:
        return msgspec.json.decode(events[-1].detail, type=kind)
    except msgspec.DecodeError as error:
        raise StudyError(
            f"the study's database: event {events[-1].id} is damaged: {error}; restore a backup"
        ) from error


def record_event_value(connection: sa.Connection, pseudonym: str, name: str, value: msgspec.Struct) -> None:
    """Store a value as JSON in a new event of a participant. ``name``: name of the event.

    Raises:
        StudyError: for an unknown participant.
    """
    participant = find_participant(connection, pseudonym)
    detail = msgspec.json.encode(value).decode()
    record_event(connection, name, detail, {"participant": participant.number})


def _as(kind: type[Row], row: Mapping[str, Any]) -> Row:
    """Returns the row as a dataclass. Raises ``ValueError`` for a value of a wrong type or an unknown state."""
    state, known = row.get("state"), TRANSITIONS_BY_TABLE.get(TABLES_BY_ROW_TYPE[kind].name, {})
    if state is not None and state not in known:
        raise ValueError(f"unknown state {state!r}; allowed: {', '.join(known)}")
    return msgspec.convert(row, kind)
