"""The links of a study's participants: a random one for each session. Only its checksum is stored."""

from avrgym.study.storage import ledger, schema
from avrgym.study.storage.rows import ParticipantLink, StudySession
from avrgym.study.storage.schema import now
from avrgym.study.storage.store import Store, find_all, find_open_session
from avrgym.vr.server.links import link_sha256, new_link


def make_link(store: Store, session_id: int) -> str:
    """A new link for an open session; ``StudyError`` for one that has ended."""
    link = new_link()
    with store.database.write() as connection:
        session = find_open_session(connection, session_id)
        ledger.insert(connection, schema.LINK, session=session.id, at=now(), sha256=link_sha256(link))
    return link


def participants_by_link(store: Store) -> dict[str, int]:
    """The participant's number of every link that was ever made, by the link's checksum."""
    with store.database.read() as connection:
        sessions = {each.id: each.participant for each in find_all(connection, StudySession)}
        return {each.sha256: sessions[each.session] for each in find_all(connection, ParticipantLink)}
