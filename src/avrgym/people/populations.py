"""Populations of simulated people for training, evaluation and live sessions.

A population is either a distribution of bodies with a behaviour model, or one trained human (human-robot co-training).
The policy file of a trained human has the same format as that of a robot.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.networks.policy import POLICY_FILE_SUFFIX, Policy, PolicyError
from avrgym.people.distributions import (
    NAMED_DISTRIBUTIONS,
    PeopleDistribution,
    find_distribution,
    make_distribution,
)
from avrgym.people.impairments import parse_impairment
from avrgym.people.population_names import ImpairmentName
from avrgym.system import random_streams
from avrgym.system.transferred_files import TransferredFile

HUMAN_POLICY_FILE = "human.safetensors"
"""Name of the file with the trained human's policy, in the folder of a training run."""


@dataclass(frozen=True, eq=False)
class Population:
    """A population: a distribution of bodies and behaviour, a default impairment, and the policy of a trained human.

    ``name`` is the name of the distribution, or the path of a people file or policy file. ``trained_policy`` is the
    policy that moves a trained human.
    """

    name: str
    distribution: PeopleDistribution
    impairment: ImpairmentName = "none"
    trained_policy: Policy | None = None

    def choose_impairment(self, requested: ImpairmentName) -> ImpairmentName:
        """Returns the requested impairment, or the population's default impairment if ``none`` is requested."""
        return self.impairment if requested == "none" else requested


def is_trained_human(name_or_path: str) -> bool:
    """Returns whether a value of ``--people`` is a policy file or a folder of policy files of trained humans.

    A path that ends with / is a folder, even if the folder no longer exists.
    """
    if name_or_path in NAMED_DISTRIBUTIONS:
        return False
    return name_or_path.endswith((POLICY_FILE_SUFFIX, "/")) or Path(name_or_path).is_dir()


def format_population_label(name_or_path: str) -> str:
    """Returns the name of a population for display. For a file, this is the name without the folder."""
    if name_or_path in NAMED_DISTRIBUTIONS:
        return name_or_path
    return f"{'trained' if is_trained_human(name_or_path) else 'fitted'}: {Path(name_or_path).name}"


def find_populations(name_or_path: str, tasks: Collection[str]) -> tuple[Population, ...]:
    """Returns the populations for a value of ``--people``. For a folder, there is one population for each trained
    human.

    Raises:
        ValueError: for an unknown name (the message lists the distributions), or for an invalid file.
    """
    if not is_trained_human(name_or_path):
        return (Population(name_or_path, find_distribution(name_or_path, tasks)),)
    if not Path(name_or_path).is_dir():
        return (_trained(Path(name_or_path), tasks),)
    files = find_human_policy_files(Path(name_or_path))
    if not files:
        raise ValueError(
            f"{name_or_path} contains no trained human; allowed: a folder of training runs with --recipe pair, or of "
            f"their {HUMAN_POLICY_FILE} files"
        )
    return tuple(_trained(file, tasks) for file in files)


def find_human_policy_files(folder: Path) -> list[Path]:
    """Returns the policy files of trained humans in a folder and in the training folders inside it.

    Robot policies are ignored.

    Raises:
        PolicyError: for a damaged file.
    """
    own, below = sorted(folder.glob(f"*{POLICY_FILE_SUFFIX}")), sorted(folder.glob(f"*/{HUMAN_POLICY_FILE}"))
    return [file for file in [*own, *below] if Policy.load(file).metadata.human is not None]


def read_people_for_workers(name_or_path: str) -> TransferredFile:
    """Returns the value of ``--people`` with the contents of its files. Worker processes may have no access to the
    files."""
    if is_trained_human(name_or_path) and Path(name_or_path).is_dir():
        return TransferredFile.read_folder(name_or_path, find_human_policy_files(Path(name_or_path)))
    return TransferredFile.read(name_or_path)


def _trained(path: Path, tasks: Collection[str]) -> Population:
    policy = Policy.load(path)
    metadata = policy.metadata
    if metadata.human is None:
        raise PolicyError(
            f"{path} is the policy of a robot; allowed: policies of trained humans. Use this file with --policy"
        )
    if policy.memory is not None:
        raise PolicyError(f"{path} is a recurrent policy; allowed: feed-forward policies of trained humans")
    if text := metadata.human.people_file:
        from avrgym.people.people_file import parse_people

        bodies = make_distribution(parse_people(text, f"{path}: its people", tasks))
    else:
        bodies = find_distribution(metadata.people, tasks)
    return Population(str(path), bodies, parse_impairment(metadata.impairment), policy)


class TrainedHumans:
    """Runs the policies of trained humans in N worlds."""

    def __init__(self, trained: Sequence[Policy], worlds: int) -> None:
        """Prepare N ``worlds``. All worlds use the first policy until ``reset``."""
        self._trained = trained
        self._human = np.zeros(worlds, dtype=np.intp)
        self._noise = [random_streams.make_trained_human_noise_rng(0.0)] * worlds

    def reset(self, ids: IntArray, humans: IntArray, uniforms: FloatArray) -> None:
        """Start episodes in worlds ``ids`` (n,). ``humans`` (n,) are the indices of the policies in these worlds.

        ``uniforms`` (n,) are the seeds of the action noise.
        """
        self._human[ids] = humans
        for world, uniform in zip(ids.tolist(), uniforms.tolist(), strict=True):
            self._noise[world] = random_streams.make_trained_human_noise_rng(uniform)

    def act(self, observations: FloatArray) -> FloatArray:
        """Returns the human's actions (N, K) for observations (N, O): joint speeds divided by their maximum, with
        noise.
        """
        actions = np.zeros((len(observations), self._trained[0].action_size))
        for number, policy in enumerate(self._trained):
            rows = np.nonzero(self._human == number)[0]
            actions[rows] = policy.act(observations[rows], [self._noise[row] for row in rows.tolist()])
        return actions

    def snapshot(self) -> dict[str, Any]:
        """Returns the state that changes during an episode: policy index and noise generator of each world."""
        return {
            "human": self._human.copy(),
            "noise": [generator.bit_generator.state for generator in self._noise],
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from the result of ``snapshot``."""
        self._human = snapshot["human"].copy()
        self._noise = [random_streams.make_trained_human_noise_rng(0.0) for _ in snapshot["noise"]]
        for generator, state in zip(self._noise, snapshot["noise"], strict=True):
            generator.bit_generator.state = state
