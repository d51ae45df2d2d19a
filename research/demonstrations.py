"""Policies from demonstrations of a simulated operator: behaviour cloning with AVR Gym's recurrent network.

    python research/demonstrations.py clone DATA OUT.safetensors    fits the network to a dataset
    python research/demonstrations.py table POLICY...               evaluates policies, and prints the note's table

DATA is a dataset of `avrgym export simulated-demonstrations` without cameras.
"""

import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from torch.nn.functional import mse_loss
from torch.optim.lr_scheduler import ExponentialLR

from avrgym.learning.configuration import RecurrentConfiguration
from avrgym.learning.evaluation import evaluate
from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.lerobot_dataset import FILE
from avrgym.learning.normaliser import Normaliser, observation_of
from avrgym.learning.recurrent_network import RecurrentNetwork, fit_network
from avrgym.policies.trained import PolicyMetadata
from avrgym.tasks.observation import robot_measured_mask

ENVIRONMENT = "avrgym/FeedingJaco-v1"
PEOPLE = "zoo/train", "zoo/unseen", "participants"
EPISODES = 50
GRADIENT_STEPS, SEQUENCES, LEARNING_RATE, DECAY = 600, 16, 1e-3, 0.02


def clone(data: Path, out: Path) -> None:
    """Fit the recurrent network of the recipe `adaptive` to the actions of a dataset, by least squares."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    observations, actions = read(data)
    normaliser = Normaliser(observation_of(ENVIRONMENT), RECURRENT_HYPERPARAMETERS.gamma)
    normaliser.obs_rms.update(observations.reshape(-1, observations.shape[-1]))
    sizes = RecurrentConfiguration(environment=ENVIRONMENT, seed=0)
    network = RecurrentNetwork(observations.shape[-1], sizes.memory_size, sizes.net_arch, actions.shape[-1])
    inputs, targets = (torch.as_tensor(each) for each in (normaliser.normalize_obs(observations), actions))
    optimizer = torch.optim.Adam(network.parameters(), LEARNING_RATE)
    schedule = ExponentialLR(optimizer, DECAY ** (1.0 / GRADIENT_STEPS))
    random = np.random.default_rng(0)
    for step in range(GRADIENT_STEPS):
        columns = random.integers(actions.shape[1], size=SEQUENCES)
        fit_network(network, optimizer, inputs[:, columns], mse_loss, [targets[:, columns]], 1.0)
        schedule.step()
        if step % 100 == 0:
            with torch.no_grad():
                print(step, float(mse_loss(network(inputs)[0], targets)), flush=True)
    metadata = PolicyMetadata(environment=ENVIRONMENT, people="demonstrations", steps=actions.size, seed=0)
    network.policy(normaliser, metadata).save(out)


def read(data: Path) -> tuple[np.ndarray, np.ndarray]:
    """Returns observations (T, N, O) in the environment's order, and actions (T, N, A)."""
    table = pq.read_table(data / "data" / FILE)
    steps = table.column("frame_index").to_numpy().max() + 1
    state, environment_state, actions = (
        np.array(table.column(name).to_pylist(), np.float32)
        for name in ("observation.state", "observation.environment_state", "action")
    )
    measured = robot_measured_mask(observation_of(ENVIRONMENT))
    observations = np.empty((len(state), len(measured)), np.float32)
    observations[:, measured], observations[:, ~measured] = state, environment_state
    episodes = [each.reshape(-1, steps, each.shape[1]).swapaxes(0, 1) for each in (observations, actions)]
    return episodes[0], episodes[1]


def table(policies: list[str]) -> None:
    """Print success, mean force and episodes over a limit of each policy with each population."""
    print("| policy | people | success | 95 % interval | mean force (N) | episodes over a limit |")
    print("|---|---|---|---|---|---|")
    for policy in policies:
        for people in PEOPLE:
            row = evaluate(ENVIRONMENT, policy, people, EPISODES, 0)
            low, high = (100.0 * each for each in row.success_ci95)
            print(
                f"| {policy} | {people} | {100.0 * row.success_rate:.0f} % | {low:.0f} to {high:.0f} % | "
                f"{row.force_mean_newton:.2f} | {row.episodes_over_limit} |",
                flush=True,
            )


if __name__ == "__main__":
    if sys.argv[1] == "clone":
        clone(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        table(sys.argv[2:])
