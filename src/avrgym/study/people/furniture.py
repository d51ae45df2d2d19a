"""A participant's own wheelchair and bed: stored as events, used in all sessions of the participant."""

import msgspec

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.study.storage.rows import participant_number
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_participant, record_event

FURNITURE_MEASURED = "own furniture measured"
"""Name of the event that stores a participant's own furniture. The latest event applies."""


def record_furniture(store: Store, pseudonym: str, furniture: RealFurniture) -> None:
    """Store the measures of a participant's own seat and bed. They apply from the next session on.

    Raises:
        StudyError: for an unknown participant.
    """
    with store.write() as connection:
        participant = find_participant(connection, pseudonym)
        detail = msgspec.json.encode(furniture).decode()
        record_event(connection, FURNITURE_MEASURED, detail, {"participant": participant.number})


def furniture_of(store: Store, pseudonym: str) -> RealFurniture | None:
    """Returns the participant's own seat and bed; ``None`` if they were not measured.

    Raises:
        StudyError: if the stored measures are damaged.
    """
    number = participant_number(pseudonym)
    own = [e for e in store.events() if (e.name, e.participant) == (FURNITURE_MEASURED, number)]
    if not own:
        return None
    try:
        return msgspec.json.decode(own[-1].detail, type=RealFurniture)
    except msgspec.DecodeError as error:
        raise StudyError(f"the study's database: event {own[-1].id} is damaged: {error}") from error
