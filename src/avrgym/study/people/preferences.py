"""Preferences of participants for the robot: stored as events, applied in the conditions that allow them."""

import msgspec

from avrgym.commands.preferences import AppliedRules, Preferences, apply_preferences
from avrgym.study.storage.rows import StudyEvent, participant_number
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_participant, record_event

PREFERENCES_RECORDED = "preferences recorded"
"""Name of the event that stores a participant's preferences. The latest event applies."""


def record_preferences(store: Store, pseudonym: str, preferences: Preferences) -> None:
    """Store a participant's preferences. They apply from the next session on.

    Raises:
        StudyError: for an unknown participant, or preferences that contradict a condition of the design. Nothing is
            stored then.
    """
    for name, rules in store.design.conditions.items():
        try:
            apply_preferences(rules, preferences)
        except ValueError as error:
            raise StudyError(f"the preferences contradict the condition {name}: {error}") from error
    detail = msgspec.json.encode(preferences).decode()
    with store.write() as connection:
        participant = find_participant(connection, pseudonym)
        record_event(connection, PREFERENCES_RECORDED, detail, {"participant": participant.number})


def preferences_of(store: Store, pseudonym: str) -> Preferences | None:
    """Returns the participant's latest preferences; ``None`` without any.

    Raises:
        StudyError: if the stored preferences are damaged.
    """
    number = participant_number(pseudonym)
    own = [e for e in store.events() if (e.name, e.participant) == (PREFERENCES_RECORDED, number)]
    return _decoded(own[-1]) if own else None


def trial_rules(store: Store, name: str, own: Preferences | None) -> AppliedRules | None:
    """Returns the rules of a trial with the condition or policy ``name``; ``None`` if nothing paces the robot.

    Raises:
        StudyError: if the participant's preferences contradict the condition.
    """
    rules = store.design.conditions.get(name)
    if rules is None or not rules.uses_pacing_layer:
        return None
    try:
        return apply_preferences(rules, own)
    except ValueError as error:
        raise StudyError(
            f"the preferences contradict the condition {name}: {error}; `avrgym study preferences` changes them"
        ) from error


def _decoded(event: StudyEvent) -> Preferences:
    try:
        return msgspec.json.decode(event.detail, type=Preferences)
    except msgspec.DecodeError as error:
        raise StudyError(f"the study's database: event {event.id} is damaged: {error}") from error
