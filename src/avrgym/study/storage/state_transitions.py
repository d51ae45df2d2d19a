"""States of participants, sessions, trials and attempts, and the allowed transitions."""

from collections.abc import Mapping

from avrgym.recording.schema import ATTEMPT_ENDS

StateTransitions = Mapping[str, tuple[str, ...]]
"""Allowed next states, by state."""

UNKNOWN_PARTICIPATION_STATE = "unknown"
"""State of a participant after the loss of the database: consent and withdrawal are unknown."""

PARTICIPANT_TRANSITIONS: StateTransitions = {
    "enrolled": ("consented", "withdrawn"),
    "consented": ("allocated", "excluded", "withdrawn"),
    "allocated": ("completed", "withdrawn"),
    "completed": ("withdrawn",),
    UNKNOWN_PARTICIPATION_STATE: ("allocated", "completed", "withdrawn"),
    "excluded": (),
    "withdrawn": (),
}
SESSION_TRANSITIONS: StateTransitions = {"open": ("closed", "interrupted"), "closed": (), "interrupted": ()}
TRIAL_TRANSITIONS: StateTransitions = {
    "planned": ("running", "skipped"),
    "skipped": ("running",),
    "running": ("planned", "completed"),
    "completed": (),
}
ATTEMPT_TRANSITIONS: StateTransitions = {"running": ATTEMPT_ENDS} | dict.fromkeys(ATTEMPT_ENDS, ())

TRANSITIONS_BY_TABLE: Mapping[str, StateTransitions] = {
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
    allowed = TRANSITIONS_BY_TABLE[table][before]
    if after not in allowed:
        follow = " or ".join(allowed) or "none, this state is final"
        raise StudyError(f"{what} is {before} and cannot become {after}; allowed: {follow}")
