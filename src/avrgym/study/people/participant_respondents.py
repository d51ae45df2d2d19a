"""The respondent of a participant's questionnaires. Answers of a proxy are marked in all tables and figures."""

from avrgym.commands.respondents import PARTICIPANT_RESPONDENT, PARTICIPANT_RESPONDENTS
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, record_event


def set_respondent(store: StudyStore, pseudonym: str, respondent: str, session: int | None = None) -> None:
    """Store the respondent of all later questions to a participant. ``session``: the id of the running session.

    Raises:
        StudyError: for a respondent that is not in ``PARTICIPANT_RESPONDENTS``, or an unknown participant.
    """
    if respondent not in PARTICIPANT_RESPONDENTS:
        raise StudyError(f"unknown respondent {respondent!r}; allowed: {', '.join(PARTICIPANT_RESPONDENTS)}")
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        stored = None if respondent == PARTICIPANT_RESPONDENT else respondent
        hash_chain.update_row(connection, schema.PARTICIPANT_TABLE, participant.number, respondent=stored)
        about = {"participant": participant.number} | ({} if session is None else {"session": session})
        record_event(connection, "respondent changed", respondent, about)
