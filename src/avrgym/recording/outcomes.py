"""How attempts at trials end and what they gave, as recordings, the study's database and all tables have it."""

from typing import Literal, get_args

import msgspec

AttemptEnd = Literal[
    "completed", "stopped", "paused", "interrupted", "repeated", "skipped", "ended", "failed"
]
"""How an attempt ended. Only ``completed`` counts: its recording is whole and the robot has finished.

Its questionnaire may be open."""
ATTEMPT_ENDS: tuple[AttemptEnd, ...] = get_args(AttemptEnd)


class Metrics(msgspec.Struct, frozen=True, omit_defaults=True):
    """What an attempt gave; ``None`` where nobody could tell.

    ``steps`` counts the control steps, ``reward`` sums up their rewards, ``success`` says whether the robot has
    succeeded, ``seconds`` is how long the attempt took, free movement and questions included.
    """

    steps: int | None = None
    reward: float | None = None
    success: bool | None = None
    seconds: float | None = None
