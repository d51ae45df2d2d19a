"""The states of participants, sessions, trials and attempts, and the allowed transitions."""

from collections.abc import Mapping

from avrgym.recording.schema import ATTEMPT_ENDS

Transitions = Mapping[str, tuple[str, ...]]

UNKNOWN = "unknown"
"""State of a participant after the loss of the database: consent and withdrawal are unknown."""

PARTICIPANT: Transitions = {
    "enrolled": ("consented", "withdrawn"),
    "consented": ("allocated", "excluded", "withdrawn"),
    "allocated": ("completed", "withdrawn"),
    "completed": ("withdrawn",),
    UNKNOWN: ("allocated", "completed", "withdrawn"),
    "excluded": (),
    "withdrawn": (),
}
SESSION: Transitions = {"open": ("closed", "interrupted"), "closed": (), "interrupted": ()}
TRIAL: Transitions = {
    "planned": ("running", "skipped"),
    "skipped": ("running",),
    "running": ("planned", "completed"),
    "completed": (),
}
ATTEMPT: Transitions = {"running": ATTEMPT_ENDS} | dict.fromkeys(ATTEMPT_ENDS, ())

TRANSITIONS: Mapping[str, Transitions] = {
    "participant": PARTICIPANT,
    "session": SESSION,
    "trial": TRIAL,
    "attempt": ATTEMPT,
}
"""By table: the states that may follow each state."""

PARTICIPATING = ("allocated", "completed")
"""States of participants that count in their cell."""


class StudyError(RuntimeError):
    """An action that the study does not allow; nothing was changed. The message contains what is allowed."""


def check_transition(table: str, what: str, before: str, after: str) -> None:
    """Raise ``StudyError`` unless ``after`` may follow ``before``."""
    allowed = TRANSITIONS[table][before]
    if after not in allowed:
        follow = " or ".join(allowed) or "none, this state is final"
        raise StudyError(f"{what} is {before} and cannot become {after}; allowed: {follow}")
