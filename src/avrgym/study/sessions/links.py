"""The links of a study's sessions, with the links of earlier sessions."""

from avrgym.study.people.participants import texts_of
from avrgym.study.storage.links import participants_by_link
from avrgym.study.storage.rows import Participant
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.texts.texts import ENGLISH, Texts
from avrgym.vr.protocol.messages import Language
from avrgym.vr.server.links import SessionLinks


def session_links(store: Store) -> SessionLinks:
    """Links for the sessions that a server will run; every earlier one has ended, in its participant's language."""
    people = {each.number: each for each in store.participants()}
    return SessionLinks(
        {sha256: _language(store, people[number]) for sha256, number in participants_by_link(store).items()}
    )


def _language(store: Store, participant: Participant) -> Language:
    """The participant's; English where the study no longer has texts in it."""
    try:
        return language_message(texts_of(store, participant))
    except StudyError:
        return language_message(ENGLISH)


def language_message(texts: Texts) -> Language:
    """A participant's language, with the words of their page."""
    return Language(texts.language, texts.direction, dict(texts.page))
