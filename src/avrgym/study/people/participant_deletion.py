"""Delete the data of one participant. Data of other participants are not changed."""

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, identity_file, schema
from avrgym.study.storage.analysis_files import ANALYSIS_FOLDER, remove_analysis
from avrgym.study.storage.database import BACKUP_FOLDER
from avrgym.study.storage.database_rows import (
    DeletedParticipant,
    InvitationUse,
    Participant,
    StudySession,
    parse_participant_number,
)
from avrgym.study.storage.remote_recordings import remove_recordings
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.sessions import may_be_running
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, find_rows
from avrgym.study.storage.study_folder import find_used_participant_numbers
from avrgym.system.files import remove_folder


def delete_participant(store: StudyStore, pseudonym: str) -> None:
    """Delete a participant's recordings, rows and name, all backups of the database, and the study's analysis.

    A tombstone stores the participant's number. The number is never used again. After a crash, a second call completes
    the deletion.

    Raises:
        StudyError: for an unknown participant, or during an open session.
    """
    number = parse_participant_number(pseudonym)
    with store.database.write_transaction() as connection:
        if not find_rows(connection, DeletedParticipant, number=number):
            simulated = _has_rows(store, connection, number) and _delete_rows(store, connection, pseudonym)
            hash_chain.insert_row(
                connection,
                schema.TOMBSTONE_TABLE,
                number=number,
                simulated=simulated,
                deleted_at=make_utc_timestamp(),
            )
        identity_file.remove_identity(store.folder, pseudonym)
    with store.database.write_transaction():
        store.database.participation_list.erase_participant(number)
    remove_recordings(store, pseudonym)
    remove_folder(store.folder / BACKUP_FOLDER)
    remove_analysis(store.folder / ANALYSIS_FOLDER)
    store.database.erase_deleted_data()


def _has_rows(store: StudyStore, connection: sa.Connection, number: int) -> bool:
    """Returns whether rows must be deleted; false if only other files of the study contain the participant."""
    return bool(
        find_rows(connection, Participant, number=number)
    ) or number not in find_used_participant_numbers(store.folder)


def _delete_rows(store: StudyStore, connection: sa.Connection, pseudonym: str) -> bool:
    """Delete all rows about a participant. Returns whether the participant was simulated."""
    participant = find_participant(connection, pseudonym)
    sessions = find_rows(connection, StudySession, participant=participant.number)
    for session in sessions:
        if session.state == "open" and may_be_running(store, session):
            raise StudyError(f"{session} is open at {session.station}; close it before the deletion")
    number = participant.number
    own = schema.SESSION_TABLE.c.participant == number
    visits = sa.select(schema.SESSION_TABLE.c.id).where(own)
    for use in find_rows(connection, InvitationUse, participant=number):  # its place remains used
        erased = {"participant": None, "service_study": None, "service_session": None}
        hash_chain.update_row(connection, schema.INVITATION_USE_TABLE, use.id, **erased)
    for table, condition in (
        (schema.NOTE_TABLE, schema.NOTE_TABLE.c.participant == number),
        (schema.ADVERSE_EVENT_TABLE, schema.ADVERSE_EVENT_TABLE.c.participant == number),
        (schema.CONSENT_TABLE, schema.CONSENT_TABLE.c.participant == number),
        (
            schema.EVENT_TABLE,
            sa.or_(schema.EVENT_TABLE.c.participant == number, schema.EVENT_TABLE.c.session.in_(visits)),
        ),
        (schema.DESIGN_TABLE, schema.DESIGN_TABLE.c.participant == number),
        (schema.ANSWER_TABLE, schema.ANSWER_TABLE.c.session.in_(visits)),
        (schema.ATTEMPT_TABLE, schema.ATTEMPT_TABLE.c.session.in_(visits)),
        (schema.TRIAL_TABLE, schema.TRIAL_TABLE.c.participant == number),
        (schema.SESSION_LINK_TABLE, schema.SESSION_LINK_TABLE.c.session.in_(visits)),
        (schema.SESSION_TABLE, own),
        (schema.PARTICIPANT_TABLE, schema.PARTICIPANT_TABLE.c.number == number),
    ):
        hash_chain.delete_rows(connection, table, condition)
    return participant.simulated
