"""Every random stream of the program: its use, and the numbers that seed it.

Each function returns a stream for a seed that a user gives, and for the numbers of an episode or an update. A stream's
own number keeps it apart from the others with the same seed. Choices such as hyperparameters, exploration noise and
checkpoints are made with episodes of the validation split; reported results come from the test split. NumPy's
``SeedSequence`` keeps both apart from training, whatever the seeds are: only they have a spawn key.
"""

from collections.abc import Callable, Iterable
from typing import Literal

from numpy.random import Generator, SeedSequence, default_rng

Split = Literal["validation", "test"]
VALIDATION: Split = "validation"
TEST: Split = "test"
SPLITS: tuple[Split, ...] = (VALIDATION, TEST)
_SPAWN_KEYS: dict[Split, int] = {VALIDATION: 1, TEST: 2}

NoiseStream = Callable[[int, int, int], Generator]
"""A stream of exploration noise: of a training's seed, its steps so far, and a world."""


def split_of(name: str) -> Split:
    """The split of a name.

    Raises:
        ValueError: for an unknown name, naming the known ones.
    """
    for split in SPLITS:
        if split == name:
            return split
    raise ValueError(f"unknown split {name!r}; allowed: {', '.join(SPLITS)}")


# Evaluation


def evaluation_episodes(split: Split, seed: int, numbers: Iterable[int]) -> list[Generator]:
    """People, starts and exploration noise of episodes of the validation or test split."""
    key = (_SPAWN_KEYS[split],)
    return [default_rng(SeedSequence([seed, number], spawn_key=key)) for number in numbers]


# Training


def training_episode(seed: int) -> Generator:
    """People and start of an episode; ``seed`` comes from ``episode_seeds`` or ``hard_episodes``."""
    return default_rng(seed)


def episode_seeds(seed: int, update: int) -> Generator:
    """Seeds of the episodes in an update of a recurrent policy."""
    return default_rng([seed, 1, update])


def imitation(seed: int, update: int) -> Generator:
    """Worlds that the expert drives in an update, then the update's minibatches."""
    return default_rng([seed, 2, update])


def hard_episodes(seed: int, steps: int) -> Generator:
    """Seeds of the episodes in an update of a feed-forward policy, new and repeated ones."""
    return default_rng([seed, 3, steps])


def robot_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of the robot's actions in an update."""
    return default_rng([seed, 4, steps, world])


def human_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of a trained human's actions in an update."""
    return default_rng([seed, 5, steps, world])


def device_minibatches(seed: int, steps: int) -> int:
    """Seed of PyTorch for the minibatches of an update on a device."""
    return int(default_rng([seed, 6, steps]).integers(2**63))
