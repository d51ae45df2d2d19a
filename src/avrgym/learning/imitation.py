"""Imitation of an expert before PPO: dataset aggregation (Ross, Gordon, Bagnell, AISTATS 2011, algorithm 3.1).

The share of worlds that the policy controls increases from round to round. The expert's actions are recorded in all
worlds. After each round, the policy is fitted to the demonstrations of all rounds.
"""

# Stable-Baselines3's attributes and PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Generic, TypeVar
from zipfile import BadZipFile

import numpy as np
import torch
from torch.nn.functional import mse_loss
from torch.optim.lr_scheduler import ExponentialLR

from avrgym.array_types import Float32Array
from avrgym.learning.hyperparameters import IMITATION_HYPERPARAMETERS
from avrgym.learning.ppo import Agent

DEMONSTRATIONS_FOLDER = "shown"


@dataclass(frozen=True)
class Demonstration:
    """Observations and the expert's actions of one round, in single precision.

    Shapes are (S, O) and (S, A) for S steps, or (T, N, O) and (T, N, A) for T steps in N worlds.
    """

    observations: Float32Array
    actions: Float32Array


D = TypeVar("D", bound=Demonstration)


class DemonstrationDataset(Generic[D]):
    """The demonstrations of all rounds of imitation. Each round has its own file."""

    def __init__(self, out: Path, kind: type[D]) -> None:
        self.rounds: list[D] = []
        self._folder, self._kind = out / DEMONSTRATIONS_FOLDER, kind

    def append(self, demonstration: D) -> None:
        """Append the demonstrations of a round, and write them into a file."""
        self._folder.mkdir(exist_ok=True)
        np.savez(self._file(len(self.rounds)), **asdict(demonstration))
        self.rounds.append(demonstration)

    def read_rounds(self, rounds: int) -> None:
        """Read the files of the first ``rounds`` rounds.

        Raises:
            ValueError: if a file is missing or damaged.
        """
        self.rounds = [self._read(self._file(number)) for number in range(rounds)]

    def concatenate(self, name: str, axis: int = 0) -> Float32Array:
        """Returns the array ``name`` of all rounds, concatenated along an axis."""
        return np.concatenate([getattr(each, name) for each in self.rounds], axis=axis)

    def _read(self, file: Path) -> D:
        try:
            with np.load(file) as arrays:
                return self._kind(**arrays)
        except (OSError, ValueError, TypeError, BadZipFile) as error:
            raise ValueError(
                f"{file}: not a file of demonstrations ({error}); start the training run again in a new folder"
            ) from error

    def _file(self, number: int) -> Path:
        return self._folder / f"round_{number:04}.npz"


def fit_actor(
    agent: Agent,
    demonstrations: DemonstrationDataset[Demonstration],
    random: np.random.Generator,
    *,
    last: bool,
) -> None:
    """Fit the actor's mean actions to all demonstrations by least squares. The last round has more epochs."""
    model, normaliser = agent
    observed = demonstrations.concatenate("observations")
    observations = torch.as_tensor(np.asarray(normaliser.normalize_obs(observed)), dtype=torch.float32)
    actions = torch.as_tensor(demonstrations.concatenate("actions"))
    actor = model.policy
    parameters = [*actor.mlp_extractor.policy_net.parameters(), *actor.action_net.parameters()]
    optimizer = torch.optim.Adam(parameters, IMITATION_HYPERPARAMETERS.learning_rate)
    epochs, decay = (
        (IMITATION_HYPERPARAMETERS.final_round_n_epochs, IMITATION_HYPERPARAMETERS.final_round_lr_decay)
        if last
        else (IMITATION_HYPERPARAMETERS.n_epochs, IMITATION_HYPERPARAMETERS.lr_decay)
    )
    steps = -(-epochs * len(observed) // IMITATION_HYPERPARAMETERS.batch_size)
    schedule = ExponentialLR(optimizer, decay ** (1.0 / steps))
    for _ in range(steps):
        rows = torch.as_tensor(random.integers(len(observed), size=IMITATION_HYPERPARAMETERS.batch_size))
        means = actor.action_net(actor.mlp_extractor.forward_actor(observations[rows]))
        loss = mse_loss(means, actions[rows])
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
