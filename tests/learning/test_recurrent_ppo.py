from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.recurrent_network import RecurrentNetwork, make_bptt_windows
from avrgym.learning.recurrent_ppo import RecurrentPPO, compute_generalised_advantages
from avrgym.tasks.constants import EPISODE_STEPS

pytestmark = pytest.mark.usefixtures("one_thread")

WORLDS, DEVIATION = 8, 0.3


def started() -> tuple[RecurrentNetwork, RecurrentPPO]:
    torch.manual_seed(1)
    network = RecurrentNetwork(3, 8, (8,), 2)
    return network, RecurrentPPO(network, 3)


def update(
    network: RecurrentNetwork, number: int, worlds: int = WORLDS
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Episodes whose reward is highest for actions of 0.5."""
    random = np.random.default_rng(number)
    observations = torch.as_tensor(
        random.standard_normal((EPISODE_STEPS + 1, worlds, 3)), dtype=torch.float32
    )
    with torch.no_grad():
        means = network(observations[:-1])[0]
    noise = torch.as_tensor(random.standard_normal(means.shape), dtype=torch.float32)
    actions = means + DEVIATION * noise
    return observations, actions, -((actions - 0.5) ** 2).sum(dim=-1)


def learn(network: RecurrentNetwork, ppo: RecurrentPPO, number: int, learning_rate: float) -> None:
    ppo.update(
        *update(network, number), DEVIATION, np.random.default_rng(number), learning_rate=learning_rate
    )


def numbers(network: torch.nn.Module) -> list[np.ndarray]:
    return [parameter.detach().numpy().copy() for parameter in network.parameters()]


def test_advantages_are_returns_minus_values():
    random = np.random.default_rng(2)
    rewards, values = (torch.as_tensor(random.standard_normal((steps, 4))) for steps in (6, 7))
    whole = compute_generalised_advantages(rewards, values, gamma=0.9, gae_lambda=1.0)
    powers = 0.9 ** torch.arange(7, dtype=torch.float64)
    returns = [
        (powers[: 6 - t, None] * rewards[t:]).sum(dim=0) + powers[6 - t] * values[-1] for t in range(6)
    ]
    assert_allclose(whole, torch.stack(returns) - values[:-1])
    one_step = compute_generalised_advantages(rewards, values, gamma=0.9, gae_lambda=0.0)
    assert_allclose(one_step, rewards + 0.9 * values[1:] - values[:-1])


@pytest.mark.slow
def test_ppo_increases_the_reward():
    network, ppo = started()
    rewards: list[float] = []
    for number in range(8):
        rewards.append(float(update(network, number)[2].mean()))
        learn(network, ppo, number, 3e-3)
    at_best = -2 * DEVIATION**2
    assert rewards[-1] - at_best > 0.2 * (rewards[0] - at_best)
    assert rewards[0] < -0.6
    assert rewards[-1] > -0.35


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("worlds", "minibatches"), [(8, 1), (64, 4), (65, 5), (160, 8)])
def test_the_number_of_minibatches_is_limited(worlds: int, minibatches: int) -> None:
    network, ppo = started()
    ppo.update(*update(network, 1, worlds), DEVIATION, np.random.default_rng(1), learning_rate=0.0)
    steps = ppo.checkpoint_state()["critic_optimizer"]["state"][0]["step"]
    assert int(steps) == RECURRENT_HYPERPARAMETERS.n_epochs * minibatches * len(
        [*make_bptt_windows(EPISODE_STEPS)]
    )


def test_without_a_learning_rate_only_the_critic_learns():
    network, ppo = started()
    before, state = numbers(network), str(ppo.checkpoint_state()["critic"])
    learn(network, ppo, 0, 0.0)
    for now, then in zip(numbers(network), before, strict=True):
        assert (now == then).all()
    assert str(ppo.checkpoint_state()["critic"]) != state


def test_an_update_ends_at_the_target_kl_divergence(monkeypatch):
    """With this learning rate one epoch exceeds the target; more epochs change nothing."""
    ends: list[list[np.ndarray]] = []
    for epochs in (1, 4):
        monkeypatch.setattr(
            "avrgym.learning.recurrent_ppo.RECURRENT_HYPERPARAMETERS",
            replace(RECURRENT_HYPERPARAMETERS, n_epochs=epochs),
        )
        network, ppo = started()
        learn(network, ppo, 0, 0.05)
        ends.append(numbers(network))
    for one, four in zip(*ends, strict=True):
        assert (one == four).all()


@pytest.mark.parametrize("steps", [30, 120, 200])
def test_windows_cover_an_episode_of_any_length(steps: int) -> None:
    covered = [step for window in make_bptt_windows(steps) for step in range(steps)[window]]
    assert covered == list(range(steps))
