"""Session links: a random link to each session. The study stores only the link's checksum."""

from avrgym.study.people.participants import read_participant_texts
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import Participant, StoredSessionLink, StudySession
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_open_session, find_rows
from avrgym.texts.interface_texts import ENGLISH_TEXTS, InterfaceTexts
from avrgym.vr.protocol.messages import Language
from avrgym.vr.server.session_links import SessionLinks, compute_token_sha256, generate_link_token


def make_session_link(
    store: StudyStore, session_id: int, role: str | None = None, link: str | None = None
) -> str:
    """Create and store a link for an open session. Returns the link. ``role``: ``caregiver``; default: participant.

    ``link``: the link to store; default: a new one.

    Raises ``StudyError`` if the session has ended.
    """
    link = link or generate_link_token()
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        hash_chain.insert_row(
            connection,
            schema.SESSION_LINK_TABLE,
            session=session.id,
            created_at=make_utc_timestamp(),
            sha256=compute_token_sha256(link),
            role=role,
        )
    return link


def read_participants_by_token_sha256(store: StudyStore) -> dict[str, int]:
    """Returns the participant number of each stored link, by the link's checksum. Includes caregivers' links."""
    with store.database.read_transaction() as connection:
        sessions = {each.id: each.participant for each in find_rows(connection, StudySession)}
        return {each.sha256: sessions[each.session] for each in find_rows(connection, StoredSessionLink)}


def load_session_links(store: StudyStore) -> SessionLinks:
    """Returns the session links of a new server. The links of all earlier sessions are expired."""
    people = {each.number: each for each in store.read_participants()}
    return SessionLinks(
        {
            sha256: _language(store, people[number])
            for sha256, number in read_participants_by_token_sha256(store).items()
        }
    )


def _language(store: StudyStore, participant: Participant) -> Language:
    """Returns the message with the participant's language, or English if the study lacks texts in this language."""
    try:
        return make_language_message(read_participant_texts(store, participant))
    except StudyError:
        return make_language_message(ENGLISH_TEXTS)


def make_language_message(texts: InterfaceTexts) -> Language:
    """Returns the message with the language, and with the texts of the participant's page."""
    return Language(texts.language, texts.direction, dict(texts.page))
