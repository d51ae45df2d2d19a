"""Whom a world may meet: one kind of people, or a population of humans who were trained beside robots.

A trained human is a file as robots' policies are. It says whose bodies the human was trained in and what impaired them;
wherever it is named, so are those who meet the robot.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.networks.policy import FILE_SUFFIX, Policy, PolicyError
from avrgym.people.distributions import NAMED_DISTRIBUTIONS, Distribution, distribution_of, find_distribution
from avrgym.people.impairments import find_impairment
from avrgym.people.population_names import Impairment
from avrgym.system import random_streams
from avrgym.system.transferred_files import TransferredFile

HUMAN_FILE = "human.safetensors"
"""What a training of robot and human calls the human's file."""


@dataclass(frozen=True, eq=False)
class Population:
    """People of one kind: their bodies and manners, what impairs them unless something else is asked for, and the
    network that moves them, if they were trained.

    ``name`` is that of the distribution, or of the file.
    """

    name: str
    distribution: Distribution
    impairment: Impairment = "none"
    trained: Policy | None = None

    def impaired(self, asked: Impairment) -> Impairment:
        """What impairs them where an impairment was asked for, or ``none``."""
        return self.impairment if asked == "none" else asked


def is_trained(name_or_path: str) -> bool:
    """Whether people are trained humans: a file of one, or a folder of several, which ends with / where it is gone."""
    if name_or_path in NAMED_DISTRIBUTIONS:
        return False
    return name_or_path.endswith((FILE_SUFFIX, "/")) or Path(name_or_path).is_dir()


def population_label(name_or_path: str) -> str:
    """What to call people where their file is not at hand."""
    if name_or_path in NAMED_DISTRIBUTIONS:
        return name_or_path
    return f"{'trained' if is_trained(name_or_path) else 'fitted'}: {Path(name_or_path).name}"


def find_populations(name_or_path: str, tasks: Collection[str]) -> tuple[Population, ...]:
    """The kinds that ``--people`` names: one, or for a folder those of all trained humans in it.

    Raises:
        ValueError: naming the distributions there are, or what is wrong in a file.
    """
    if not is_trained(name_or_path):
        return (Population(name_or_path, find_distribution(name_or_path, tasks)),)
    if not Path(name_or_path).is_dir():
        return (_trained(Path(name_or_path), tasks),)
    files = human_files(Path(name_or_path))
    if not files:
        raise ValueError(
            f"{name_or_path} holds no trained human; allowed: a folder with {HUMAN_FILE} of trainings "
            f"with --recipe pair, in folders of their own or beside each other"
        )
    return tuple(_trained(file, tasks) for file in files)


def human_files(folder: Path) -> list[Path]:
    """The trained humans in a folder: its own files, and one for each training in a folder below it.

    Robots' policies beside them are passed over.

    Raises:
        PolicyError: for a file that is damaged.
    """
    beside, below = sorted(folder.glob(f"*{FILE_SUFFIX}")), sorted(folder.glob(f"*/{HUMAN_FILE}"))
    return [file for file in [*beside, *below] if Policy.load(file).metadata.human is not None]


def transferred_people(name_or_path: str) -> TransferredFile:
    """People for processes that may not see their files."""
    if is_trained(name_or_path) and Path(name_or_path).is_dir():
        return TransferredFile.read_folder(name_or_path, human_files(Path(name_or_path)))
    return TransferredFile.read(name_or_path)


def _trained(path: Path, tasks: Collection[str]) -> Population:
    policy = Policy.load(path)
    metadata = policy.metadata
    if metadata.human is None:
        raise PolicyError(f"{path}: a robot's policy, and no human; --policy takes it")
    if policy.memory is not None:
        raise PolicyError(f"{path}: a human who remembers; only those without a memory are allowed")
    if text := metadata.human.people_file:
        from avrgym.people.people_file import parse_people  # with what reads and writes such files

        bodies = distribution_of(parse_people(text, f"{path}: its people", tasks))
    else:
        bodies = find_distribution(metadata.people, tasks)
    return Population(str(path), bodies, find_impairment(metadata.impairment), policy)


class TrainedHumans:
    """Trained humans at work in N worlds: who is in which, and the chance that each acts with."""

    def __init__(self, trained: Sequence[Policy], worlds: int) -> None:
        """The first of them everywhere, until the first ``reset``."""
        self._trained = trained
        self._who = np.zeros(worlds, dtype=np.intp)
        self._chance = [random_streams.trained_human_noise(0.0)] * worlds

    def reset(self, ids: IntArray, who: IntArray, uniforms: FloatArray) -> None:
        """Begin episodes in worlds ``ids`` (n,) of humans ``who`` (n,), with chance from uniform numbers (n,)."""
        self._who[ids] = who
        for world, uniform in zip(ids.tolist(), uniforms.tolist(), strict=True):
            self._chance[world] = random_streams.trained_human_noise(uniform)

    def act(self, observations: FloatArray) -> FloatArray:
        """Their actions (N, K) for what they observe (N, O), one control step on."""
        acted = np.zeros((len(observations), self._trained[0].action_size))
        for number, policy in enumerate(self._trained):
            rows = np.nonzero(self._who == number)[0]
            acted[rows] = policy.act(observations[rows], [self._chance[row] for row in rows.tolist()])
        return acted

    def saved(self) -> dict[str, Any]:
        """All that changes."""
        return {
            "who": self._who.copy(),
            "chance": [generator.bit_generator.state for generator in self._chance],
        }

    def restore(self, saved: dict[str, Any]) -> None:
        """Go on from what ``saved`` gave."""
        self._who = saved["who"].copy()
        self._chance = [random_streams.trained_human_noise(0.0) for _ in saved["chance"]]
        for generator, state in zip(self._chance, saved["chance"], strict=True):
            generator.bit_generator.state = state
