"""States of participants, sessions, trials and attempts, and the allowed transitions."""

from collections.abc import Mapping

from avrgym.recording.schema import ATTEMPT_ENDS

Transitions = Mapping[str, tuple[str, ...]]

UNKNOWN = "unknown"
"""State of a participant with unknown consent and withdrawal, after the loss of the database."""

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
"""Allowed next states of each state, by table."""

PARTICIPATING = ("allocated", "completed")
"""States of participants who are counted in their cell of the design."""


class StudyError(RuntimeError):
    """The study does not allow an action. Nothing was changed. The message contains the allowed actions or values."""


def check_transition(table: str, what: str, before: str, after: str) -> None:
    """Raise ``StudyError`` if the transition from state ``before`` to state ``after`` is not allowed."""
    allowed = TRANSITIONS[table][before]
    if after not in allowed:
        follow = " or ".join(allowed) or "none, this state is final"
        raise StudyError(f"{what} is {before} and cannot become {after}; allowed: {follow}")
