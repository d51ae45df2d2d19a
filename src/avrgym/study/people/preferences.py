"""Preferences of participants for the robot: stored as events, applied in the conditions that allow them."""

from avrgym.commands.preferences import Preferences, TrialRules, apply_preferences
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, read_latest_event_value, record_event_value

PREFERENCES_RECORDED_EVENT = "preferences recorded"
"""Name of the event that stores a participant's preferences. The latest event applies."""


def record_preferences(store: StudyStore, pseudonym: str, preferences: Preferences) -> None:
    """Store a participant's preferences. They apply from the next session on.

    Raises:
        StudyError: for an unknown participant, or preferences that contradict a condition of the design. Nothing is
            stored then.
    """
    for name, rules in store.design.conditions.items():
        try:
            apply_preferences(rules, preferences)
        except ValueError as error:
            raise StudyError(
                f"the preferences contradict the condition {name}: {error}. Nothing was stored"
            ) from error
    with store.write_transaction() as connection:
        record_event_value(connection, pseudonym, PREFERENCES_RECORDED_EVENT, preferences)


def read_latest_preferences(store: StudyStore, pseudonym: str) -> Preferences | None:
    """Returns the participant's latest preferences; ``None`` without any.

    Raises:
        StudyError: if the stored preferences are damaged.
    """
    return read_latest_event_value(store, pseudonym, PREFERENCES_RECORDED_EVENT, Preferences)


def make_trial_rules(store: StudyStore, name: str, own: Preferences | None) -> TrialRules | None:
    """Returns the rules of a trial with the condition or policy ``name``; ``None`` without a pacing layer.

    ``own``: the participant's preferences; ``None`` without any.

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
