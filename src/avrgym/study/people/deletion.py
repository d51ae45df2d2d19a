"""Delete the data of one participant. Data of other participants are not changed."""

import shutil

import sqlalchemy as sa

from avrgym.study.storage import hash_chain, identity_file, schema
from avrgym.study.storage.analysis_files import FOLDER, remove_analysis
from avrgym.study.storage.database import BACKUPS
from avrgym.study.storage.rows import (
    RECORDINGS,
    InvitationUse,
    Participant,
    StudySession,
    Tombstone,
    participant_number,
)
from avrgym.study.storage.schema import now
from avrgym.study.storage.sessions import may_be_running
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all, find_participant
from avrgym.study.storage.study_folder import used_numbers


def delete_participant(store: Store, pseudonym: str) -> None:
    """Delete a participant's recordings, rows and name, all backups of the database, and the study's analysis.

    A tombstone stores the participant's number. The number is never used again. After a crash, a second call completes
    the deletion.

    Raises:
        StudyError: for an unknown participant, or during an open session.
    """
    number = participant_number(pseudonym)
    with store.database.write() as connection:
        if not find_all(connection, Tombstone, number=number):
            simulated = _has_rows(store, connection, number) and _delete_rows(store, connection, pseudonym)
            hash_chain.insert(
                connection, schema.TOMBSTONE, number=number, simulated=simulated, deleted_at=now()
            )
        identity_file.remove_entry(store.folder, pseudonym)
    with store.database.write():
        store.database.participation.erase(number)
    _remove(store, f"{RECORDINGS}/{pseudonym}")
    _remove(store, BACKUPS)
    remove_analysis(store.folder / FOLDER)
    store.database.erase_traces()


def _has_rows(store: Store, connection: sa.Connection, number: int) -> bool:
    """Returns whether rows must be deleted; false if only other files of the study contain the participant."""
    return bool(find_all(connection, Participant, number=number)) or number not in used_numbers(store.folder)


def _delete_rows(store: Store, connection: sa.Connection, pseudonym: str) -> bool:
    """Delete all rows about a participant. Returns whether the participant was simulated."""
    participant = find_participant(connection, pseudonym)
    sessions = find_all(connection, StudySession, participant=participant.number)
    for session in sessions:
        if session.state == "open" and may_be_running(store, session):
            raise StudyError(f"{session} is open at {session.station}; close it before the deletion")
    number = participant.number
    own = schema.SESSION.c.participant == number
    visits = sa.select(schema.SESSION.c.id).where(own)
    for use in find_all(connection, InvitationUse, participant=number):  # its place remains used
        erased = {"participant": None, "service_study": None, "service_session": None}
        hash_chain.update(connection, schema.INVITATION_USE, use.id, **erased)
    for table, condition in (
        (schema.NOTE, schema.NOTE.c.participant == number),
        (schema.ADVERSE_EVENT, schema.ADVERSE_EVENT.c.participant == number),
        (schema.CONSENT, schema.CONSENT.c.participant == number),
        (schema.EVENT, sa.or_(schema.EVENT.c.participant == number, schema.EVENT.c.session.in_(visits))),
        (schema.DESIGN, schema.DESIGN.c.participant == number),
        (schema.ANSWER, schema.ANSWER.c.session.in_(visits)),
        (schema.ATTEMPT, schema.ATTEMPT.c.session.in_(visits)),
        (schema.TRIAL, schema.TRIAL.c.participant == number),
        (schema.LINK, schema.LINK.c.session.in_(visits)),
        (schema.SESSION, own),
        (schema.PARTICIPANT, schema.PARTICIPANT.c.number == number),
    ):
        hash_chain.delete(connection, table, condition)
    return participant.simulated


def _remove(store: Store, name: str) -> None:
    """Remove a folder of the study. If the folder is a symbolic link, only the link is removed."""
    path = store.folder / name
    if path.is_symlink():
        path.unlink()
    elif path.exists():
        shutil.rmtree(path)
