"""Three kinds of episodes that never meet: to train on, to choose by, and to show figures of.

Whatever is chosen, such as settings, chances or checkpoints, is chosen by figures of the stream ``choosing``; figures
that are shown come from ``showing``, of which no choice has seen an episode. Episodes of trainings are drawn from
seeds without a spawn key, those of either stream with a key of its own: NumPy's ``SeedSequence`` keeps them apart,
whatever the seeds are.
"""

from collections.abc import Iterable
from typing import Literal

import numpy as np

Stream = Literal["choosing", "showing"]

CHOOSING: Stream = "choosing"
SHOWING: Stream = "showing"
_SPAWN_KEYS: dict[Stream, int] = {CHOOSING: 1, SHOWING: 2}


def episode_generators(stream: Stream, seed: int, numbers: Iterable[int]) -> list[np.random.Generator]:
    """What draws episodes of a stream, each known by the seed and its number."""
    key = (_SPAWN_KEYS[stream],)
    return [
        np.random.default_rng(np.random.SeedSequence([seed, number], spawn_key=key)) for number in numbers
    ]


def stream_of(name: str) -> Stream:
    """The stream of a name.

    Raises:
        ValueError: for an unknown one, naming those that there are.
    """
    for stream in _SPAWN_KEYS:
        if stream == name:
            return stream
    raise ValueError(f"unknown stream {name!r}; allowed: {', '.join(_SPAWN_KEYS)}")
