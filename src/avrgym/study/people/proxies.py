"""Proxies who answer questionnaires for a participant. Their answers are marked in all tables and figures."""

from avrgym.commands.respondents import ANSWERING, PARTICIPANT
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_participant, record_event


def set_respondent(store: Store, pseudonym: str, respondent: str, session: int | None = None) -> None:
    """Store who answers the questions to a participant from now on. ``session``: the id of the running session.

    Raises:
        StudyError: for another respondent than ``ANSWERING``, or an unknown participant.
    """
    if respondent not in ANSWERING:
        raise StudyError(f"unknown respondent {respondent!r}; allowed: {', '.join(ANSWERING)}")
    with store.write() as connection:
        participant = find_participant(connection, pseudonym)
        stored = None if respondent == PARTICIPANT else respondent
        hash_chain.update(connection, schema.PARTICIPANT, participant.number, respondent=stored)
        about = {"participant": participant.number} | ({} if session is None else {"session": session})
        record_event(connection, "respondent changed", respondent, about)
