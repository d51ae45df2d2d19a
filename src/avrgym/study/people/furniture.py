"""A participant's own wheelchair and bed: stored as events, used in all sessions of the participant."""

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.study.storage.store import StudyStore, read_latest_event_value, record_event_value

FURNITURE_MEASURED_EVENT = "own furniture measured"
"""Name of the event that stores a participant's own furniture. The latest event applies."""


def record_own_furniture(store: StudyStore, pseudonym: str, furniture: RealFurniture) -> None:
    """Store the dimensions of a participant's own seat and bed. They apply from the next session on.

    Raises:
        StudyError: for an unknown participant.
    """
    with store.write_transaction() as connection:
        record_event_value(connection, pseudonym, FURNITURE_MEASURED_EVENT, furniture)


def read_own_furniture(store: StudyStore, pseudonym: str) -> RealFurniture | None:
    """Returns the participant's own seat and bed; ``None`` if they were not measured.

    Raises:
        StudyError: if the stored dimensions are damaged.
    """
    return read_latest_event_value(store, pseudonym, FURNITURE_MEASURED_EVENT, RealFurniture)
