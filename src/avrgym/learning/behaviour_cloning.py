"""Behaviour cloning: fits the recurrent network of the recipe ``adaptive`` to LeRobot datasets, by least squares.

Frames in which an operator corrected a policy have a larger weight. The sum of their weights equals that of all other
demonstrations (intervention weighted regression, Mandlekar et al., arXiv:2012.06733). In the same episodes, frames that
the policy controlled have weight 0.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import torch
from torch.optim.lr_scheduler import ExponentialLR

from avrgym.array_types import Float32Array, NumpyArray
from avrgym.learning.configuration import RecurrentConfiguration
from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.lerobot_dataset import INTERVENTION
from avrgym.learning.normaliser import Normaliser, make_observation_description
from avrgym.learning.recurrent_network import RecurrentNetwork, fit_network
from avrgym.policies.lerobot import ENVIRONMENT_STATE_FEATURE, STATE_FEATURE
from avrgym.policies.trained_policies import Policy, PolicyMetadata
from avrgym.system.random_streams import make_cloning_minibatch_rng
from avrgym.tasks.observation import list_value_names, make_robot_measured_mask
from avrgym.tasks.registry import find_environment, get_observation_and_action_size
from avrgym.tasks.settings import DEFAULT_SETTINGS

GRADIENT_STEPS, SEQUENCES_PER_STEP = 600, 16
LEARNING_RATE, LEARNING_RATE_DECAY = 1e-3, 0.02


@dataclass(frozen=True)
class ClonedEpisodes:
    """N episodes of T steps: ``observations`` (T, N, O), ``actions`` (T, N, A) and ``weights`` (T, N) of frames.

    Shorter episodes are filled up with frames of weight 0.
    """

    observations: Float32Array
    actions: Float32Array
    weights: Float32Array


def clone(
    environment: str,
    episodes: ClonedEpisodes,
    seed: int = 0,
    report: Callable[[int, float], None] = lambda steps, loss: None,
) -> Policy:
    """Trains and returns a recurrent policy that imitates episodes.

    Args:
        environment: environment id such as ``avrgym/FeedingJaco-v1``.
        episodes: demonstrations to imitate.
        seed: seed of initial weights and of the order of episodes.
        report: called after each gradient step. Arguments: the number of completed steps, and the weighted mean squared
            error of actions in this step.
    """
    torch.set_num_threads(1)  # more threads would change the order of sums
    random = make_cloning_minibatch_rng(seed)
    normaliser = Normaliser(make_observation_description(environment), RECURRENT_HYPERPARAMETERS.gamma)
    normaliser.obs_rms.update(episodes.observations[episodes.weights > 0.0])
    sizes = RecurrentConfiguration(environment=environment)
    observation_size, action_size = get_observation_and_action_size(environment)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = RecurrentNetwork(observation_size, sizes.memory_size, sizes.net_arch, action_size)
    inputs, actions, weights = (
        torch.as_tensor(each)
        for each in (normaliser.normalize_obs(episodes.observations), episodes.actions, episodes.weights)
    )
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    schedule = ExponentialLR(optimizer, LEARNING_RATE_DECAY ** (1.0 / GRADIENT_STEPS))
    losses: list[float] = []

    def loss(outputs: torch.Tensor, targets: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        errors = ((outputs - targets) ** 2).mean(dim=-1)
        found = (weights * errors).sum() / weights.sum().clamp(min=1.0)
        losses.append(float(found.detach()))
        return found

    for step in range(GRADIENT_STEPS):
        columns = torch.as_tensor(random.integers(inputs.shape[1], size=SEQUENCES_PER_STEP))
        targets = [actions[:, columns], weights[:, columns]]
        fit_network(network, optimizer, inputs[:, columns], loss, targets, 1.0)
        schedule.step()
        report(step + 1, float(np.mean(losses)))
        losses.clear()
    frames = int((episodes.weights > 0.0).sum())
    metadata = PolicyMetadata(environment=environment, people="demonstrations", steps=frames, seed=seed)
    return network.to_policy(normaliser, metadata)


def read_episodes(
    environment: str, datasets: Sequence[Path], max_episodes: int | None = None
) -> ClonedEpisodes:
    """Reads LeRobot datasets without images, as from ``avrgym export``. Returns their episodes.

    ``max_episodes`` is the maximum number of episodes from each dataset; by default, all episodes are used.

    Raises:
        ValueError: if a folder contains no such dataset, or a dataset with other observations or actions.
    """
    found: list[tuple[Float32Array, Float32Array, NumpyArray]] = []
    for folder in datasets:
        found += _read(environment, folder)[:max_episodes]
    corrected = [marks.any() for *_, marks in found]
    demonstrated = sum(len(actions) for (_, actions, _), use in zip(found, corrected, strict=True) if not use)
    corrections = sum(int(marks.sum()) for *_, marks in found)
    weight = demonstrated / corrections if corrections and demonstrated else 1.0
    length = max(len(actions) for _, actions, _ in found)

    def padded(rows: Sequence[NumpyArray]) -> Float32Array:
        widths = [[(0, length - len(row)), *[(0, 0)] * (row.ndim - 1)] for row in rows]
        return np.stack([np.pad(row, width) for row, width in zip(rows, widths, strict=True)], axis=1).astype(
            np.float32
        )

    weights = [
        weight * marks if use else np.ones(len(marks))
        for (*_, marks), use in zip(found, corrected, strict=True)
    ]
    return ClonedEpisodes(
        padded([observations for observations, *_ in found]),
        padded([actions for _, actions, _ in found]),
        padded(weights),
    )


def _read(environment: str, folder: Path) -> list[tuple[Float32Array, Float32Array, NumpyArray]]:
    """Returns observations (T, O), actions (T, A) and the mask of corrected frames (T,) of each episode in a
    dataset.
    """
    observation = make_observation_description(environment)
    measured, names = make_robot_measured_mask(observation), np.array(list_value_names(observation))
    try:
        info: dict[str, Any] = json.loads((folder / "meta" / "info.json").read_bytes())
        features: dict[str, Any] = info["features"]
        found = info["robot_type"], info["fps"]
        parts = sorted((folder / "data").glob("*/*.parquet"))
        tables = [pq.read_table(part) for part in parts]
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise ValueError(
            f"{folder}: not a LeRobot dataset ({type(error).__name__}: {error}); allowed: a folder of `avrgym export`"
        ) from error
    robot, control_hz = find_environment(environment)[1], DEFAULT_SETTINGS.control_hz
    if found != (robot, control_hz):
        raise ValueError(
            f"{folder}: demonstrations with the robot {found[0]} at {found[1]} Hz; {environment} needs {robot} at "
            f"{control_hz} Hz"
        )
    for feature, expected in (
        (STATE_FEATURE, names[measured]),
        (ENVIRONMENT_STATE_FEATURE, names[~measured]),
    ):
        stored: list[str] = features[feature]["names"] if feature in features else []
        if [*stored] != [*expected]:
            raise ValueError(
                f"{folder}: {feature} contains {', '.join(stored) or 'nothing'}; {environment} needs "
                f"{', '.join(expected)}. Export demonstrations of this environment without --camera"
            )

    def column(name: str) -> NumpyArray:
        return np.concatenate([np.array(table.column(name).to_pylist()) for table in tables])

    actions, number = column("action").astype(np.float32), column("episode_index")
    marks = column(INTERVENTION) if INTERVENTION in features else np.zeros(len(actions), bool)
    observations = np.empty((len(actions), len(measured)), np.float32)
    for feature, mask in ((STATE_FEATURE, measured), (ENVIRONMENT_STATE_FEATURE, ~measured)):
        if mask.any():
            observations[:, mask] = column(feature)
    episodes = [number == each for each in np.unique(number)]
    return [(observations[rows], actions[rows], marks[rows]) for rows in episodes]
