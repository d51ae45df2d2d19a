"""The states that a study's things go through, and no others."""

from collections.abc import Mapping

from avrgym.recording.schema import ATTEMPT_ENDS

Transitions = Mapping[str, tuple[str, ...]]

UNKNOWN = "unknown"
"""The state of participants whose consent or withdrawal is unknown, because the database was lost."""

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
"""By table: each state, and those that may follow it."""

PARTICIPATING = ("allocated", "completed")
"""States of participants who count in their cell."""


class StudyError(RuntimeError):
    """Something that a study does not allow, with what it allows; nothing was changed."""


def check_transition(table: str, what: str, before: str, after: str) -> None:
    """Raise ``StudyError`` unless ``after`` may follow ``before``."""
    allowed = TRANSITIONS[table][before]
    if after not in allowed:
        follow = " or ".join(allowed) or "nothing: it is final"
        raise StudyError(f"{what} is {before} and cannot become {after}; what may follow: {follow}")
