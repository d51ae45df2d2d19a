"""Session links: a random link to each session. The study stores only the link's checksum."""

from avrgym.study.people.participants import participant_texts
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.rows import Participant, StoredSessionLink, StudySession
from avrgym.study.storage.schema import utc_timestamp
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_open_session, find_rows
from avrgym.texts.interface_texts import ENGLISH_TEXTS, InterfaceTexts
from avrgym.vr.protocol.messages import Language
from avrgym.vr.server.session_links import SessionLinks, new_link, token_sha256


def make_session_link(store: Store, session_id: int, role: str | None = None, link: str | None = None) -> str:
    """Create and store a link for an open session. Returns the link. ``role``: ``caregiver``; default: participant.

    ``link``: the link to store; default: a new one.

    Raises ``StudyError`` if the session has ended.
    """
    link = link or new_link()
    with store.database.write_transaction() as connection:
        session = find_open_session(connection, session_id)
        hash_chain.insert(
            connection,
            schema.LINK_TABLE,
            session=session.id,
            created_at=utc_timestamp(),
            sha256=token_sha256(link),
            role=role,
        )
    return link


def participants_by_link_sha256(store: Store) -> dict[str, int]:
    """Returns the participant number of each stored link, by the link's checksum. Includes caregivers' links."""
    with store.database.read_transaction() as connection:
        sessions = {each.id: each.participant for each in find_rows(connection, StudySession)}
        return {each.sha256: sessions[each.session] for each in find_rows(connection, StoredSessionLink)}


def session_links(store: Store) -> SessionLinks:
    """Returns the session links of a new server. The links of all earlier sessions are expired."""
    people = {each.number: each for each in store.participants()}
    return SessionLinks(
        {
            sha256: _language(store, people[number])
            for sha256, number in participants_by_link_sha256(store).items()
        }
    )


def _language(store: Store, participant: Participant) -> Language:
    """Returns the message with the participant's language, or English if the study lacks texts in this language."""
    try:
        return language_message(participant_texts(store, participant))
    except StudyError:
        return language_message(ENGLISH_TEXTS)


def language_message(texts: InterfaceTexts) -> Language:
    """Returns the message with the language, and with the texts of the participant's page."""
    return Language(texts.language, texts.direction, dict(texts.page))
