"""States of participants, sessions, trials and attempts, and the allowed transitions."""

from collections.abc import Mapping

from avrgym.recording.schema import ATTEMPT_ENDS

Transitions = Mapping[str, tuple[str, ...]]
"""Allowed next states, by state."""

UNKNOWN_PARTICIPATION = "unknown"
"""State of a participant after the loss of the database: consent and withdrawal are unknown."""

PARTICIPANT_TRANSITIONS: Transitions = {
    "enrolled": ("consented", "withdrawn"),
    "consented": ("allocated", "excluded", "withdrawn"),
    "allocated": ("completed", "withdrawn"),
    "completed": ("withdrawn",),
    UNKNOWN_PARTICIPATION: ("allocated", "completed", "withdrawn"),
    "excluded": (),
    "withdrawn": (),
}
SESSION_TRANSITIONS: Transitions = {"open": ("closed", "interrupted"), "closed": (), "interrupted": ()}
TRIAL_TRANSITIONS: Transitions = {
    "planned": ("running", "skipped"),
    "skipped": ("running",),
    "running": ("planned", "completed"),
    "completed": (),
}
ATTEMPT_TRANSITIONS: Transitions = {"running": ATTEMPT_ENDS} | dict.fromkeys(ATTEMPT_ENDS, ())

TRANSITIONS: Mapping[str, Transitions] = {
    "participant": PARTICIPANT_TRANSITIONS,
    "session": SESSION_TRANSITIONS,
    "trial": TRIAL_TRANSITIONS,
    "attempt": ATTEMPT_TRANSITIONS,
}
"""Allowed next states of each state, by table."""

ALLOCATED_STATES = ("allocated", "completed")
"""States of participants with an allocated trial order. The allocation of the next order counts them."""


class StudyError(RuntimeError):
    """Raised if a study does not allow an action. Nothing was changed. The message lists allowed actions or values."""


class LostConnectionError(StudyError):
    """Raised if the connection to the database was lost. An action that was not complete may be repeated."""


def check_transition(table: str, what: str, before: str, after: str) -> None:
    """Raises ``StudyError`` if a row may not change from state ``before`` to ``after``. ``what``: name of the row."""
    allowed = TRANSITIONS[table][before]
    if after not in allowed:
        follow = " or ".join(allowed) or "none, this state is final"
        raise StudyError(f"{what} is {before} and cannot become {after}; allowed: {follow}")
