"""Training on a device: the same recipe and files, and the same bits when resumed."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3", reason="training is an extra")
pytest.importorskip("mujoco_warp", reason="the extra `gpu` is not installed: 400 MB")
pytest.importorskip("rsl_rl", reason="the extra `gpu` is not installed: RSL-RL is missing")
pytest.importorskip("tensordict", reason="the extra `gpu` is not installed: RSL-RL needs tensordict")

import torch

from avrgym.cli.main import app
from avrgym.learning import training
from avrgym.learning.configuration import FeedforwardConfiguration, read_configuration
from avrgym.learning.normaliser import Normaliser, make_observation_description
from avrgym.learning.ppo import (
    Agent,
    export_policy,
    make_ppo,
    set_actor_trainable,
    set_log_std,
    update_ppo_on_host,
)
from avrgym.learning.rollouts import Rollout, RolloutRequest, WorldSettings, roll_out
from avrgym.learning.rsl_rl_ppo import DevicePPO
from avrgym.learning.training import TrainingProgress, resume_training, train
from avrgym.policies.actors import DeviceActor
from avrgym.policies.trained_policies import Policy, PolicyMetadata, find_policy_file
from avrgym.simulation.engines import warp
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.registry import get_observation_and_action_size

SCRATCHING = "avrgym/ScratchItchJaco-v1"
WORLDS, STEPS = 2, 12
UPDATE = WORLDS * STEPS
TINY = FeedforwardConfiguration(
    environment=SCRATCHING,
    people="revised",
    steps=3 * UPDATE,
    seed=4,
    num_envs=WORLDS,
    episode_steps=STEPS,
    batch_size=8,
    n_epochs=2,
    threads=1,
    imitation_rounds=1,
    imitation_share=0.5,
    critic_updates=1,
    force_weight_per_n=0.05,
    detour_weight_per_m=5.0,
    hard_share=0.5,
    engine="warp:cpu",
)

METADATA = PolicyMetadata(environment=SCRATCHING, people="", steps=0, seed=0)


@pytest.fixture(autouse=True)
def _brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """One episode in the evaluation."""
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)


# One update


def test_rollouts_on_the_device_equal_those_on_threads() -> None:
    """The same policy, noise, starts and penalties."""
    policy = Policy.load(find_policy_file("revised", SCRATCHING))
    here, there = (
        roll_out(
            policy,
            RolloutRequest(
                WorldSettings(
                    SCRATCHING, TransferredFile.read("revised"), "none", 1, engine, episode_steps=STEPS
                ),
                first_world_index=0,
                episode_seeds=np.arange(50, 50 + WORLDS),
                noise_seed=(3, 400),
                force_weight_per_n=0.1,
                detour_weight_per_m=5.0,
            ),
        )
        for engine in ("threads", "warp:cpu")
    )
    assert isinstance(there.observations, torch.Tensor)
    for name in ("observations", "actions", "rewards", "episode_return", "episode_force_n"):
        found, wanted = getattr(there, name), getattr(here, name)
        assert found.shape == wanted.shape
        assert_allclose(found, wanted, atol=0.02, err_msg=name)
    assert isinstance(there.success, np.ndarray)
    assert np.ptp(here.rewards) > 0.1


def test_a_policy_acts_equally_on_device_and_host(rng: np.random.Generator) -> None:
    policy = Policy.load(find_policy_file("revised", SCRATCHING))
    observations = 4.0 * rng.normal(size=(50, policy.observation_size))
    double = DeviceActor(policy, torch.zeros(1, dtype=torch.float64)).compute_mean_actions(
        torch.as_tensor(observations)
    )
    assert_allclose(double, policy.compute_mean_actions(observations), atol=1e-6)


def seen_and_done(rng: np.random.Generator, worlds: int) -> tuple[Any, Any, Any]:
    """Normalised observations, actions and rewards of some update."""
    observation, action = get_observation_and_action_size(SCRATCHING)
    return (
        torch.as_tensor(rng.normal(size=(STEPS + 1, worlds, observation)), dtype=torch.float32),
        torch.as_tensor(rng.normal(size=(STEPS, worlds, action)), dtype=torch.float32),
        torch.as_tensor(rng.normal(size=(STEPS, worlds)), dtype=torch.float32),
    )


@pytest.mark.parametrize("actor_learns", [True, False])
def test_both_implementations_of_ppo_give_the_same_update(
    actor_learns: bool, rng: np.random.Generator, tmp_path: Path
) -> None:
    """With one minibatch per update and no clipped gradients, where the two do not differ."""
    worlds = 5
    how = replace(
        TINY,
        num_envs=worlds,
        batch_size=worlds * STEPS,
        n_epochs=4,
        imitation_rounds=0 if actor_learns else 1,
        steps=2400,
    )
    given = seen_and_done(rng, worlds)
    networks: list[dict[str, torch.Tensor]] = []
    before: dict[str, torch.Tensor] = {}
    for update in (update_ppo_on_host, DevicePPO(how)):
        model = make_ppo(how, *get_observation_and_action_size(SCRATCHING), tmp_path)
        model.set_logger(ppo_logger())
        model.num_timesteps, model.max_grad_norm = worlds * STEPS, 1e9
        before = {name: value.clone() for name, value in model.policy.state_dict().items()}
        set_log_std(model, how)
        set_actor_trainable(model, how)
        update(model, *(each.numpy() if update is update_ppo_on_host else each for each in given))
        networks.append(model.policy.state_dict())
    here, there = networks
    for name, wanted in here.items():
        assert_allclose(there[name], wanted, atol=2e-6, err_msg=name)
    moved = {name for name, value in here.items() if not torch.equal(value, before[name])}
    assert ("action_net.weight" in moved) == actor_learns
    assert "value_net.weight" in moved


def ppo_logger():
    from stable_baselines3.common.utils import configure_logger

    return configure_logger(0)


def test_the_exported_policy_equals_the_network(rng: np.random.Generator, tmp_path: Path) -> None:
    model = make_ppo(TINY, *get_observation_and_action_size(SCRATCHING), tmp_path)
    model.set_logger(ppo_logger())
    normaliser = Normaliser(make_observation_description(SCRATCHING), TINY.gamma)
    observations, actions, rewards = seen_and_done(rng, WORLDS)
    DevicePPO(TINY)(model, observations, actions, rewards)
    exported = export_policy(Agent(model, normaliser), -1.0, METADATA)
    last = cast(Any, model.policy).action_net.weight
    assert_array_equal(exported.weights[-1], last.detach().T)
    plain = rng.uniform(-3.0, 3.0, (200, observations.shape[-1]))
    network = cast(Any, model.policy.double())
    with torch.no_grad():
        latent = network.mlp_extractor.forward_actor(
            torch.as_tensor(normaliser.normalize_obs(plain)).double()
        )
        assert_allclose(exported.compute_mean_actions(plain), network.action_net(latent), atol=1e-6)


def test_the_normaliser_works_equally_with_tensors(rng: np.random.Generator) -> None:
    observations, actions, rewards = (each.numpy() for each in seen_and_done(rng, 3))
    here, there = (Normaliser(make_observation_description(SCRATCHING), 0.9) for _ in range(2))
    rest = {"episode_return": np.zeros(3), "success": np.zeros(3, dtype=bool), "episode_force_n": np.zeros(3)}
    given = {"observations": observations, "actions": actions, "rewards": rewards}
    on_host = Rollout(**given, **rest)
    on_it = Rollout(**{name: torch.as_tensor(each) for name, each in given.items()}, **rest)
    for _ in range(2):
        assert_allclose(there.normalize_rewards(on_it), here.normalize_rewards(on_host), atol=1e-6)
        for normaliser, rollout in ((here, on_host), (there, on_it)):
            normaliser.update_observations(rollout)
    assert_allclose(there.obs_rms.var, here.obs_rms.var)
    assert_allclose(there.ret_rms.mean, here.ret_rms.mean)
    assert_allclose(
        there.normalize_obs(on_it.observations), here.normalize_obs(on_host.observations), atol=1e-6
    )


# Whole trainings


class Killed(Exception):
    """The training was killed."""


def trained(
    configuration: FeedforwardConfiguration, out: Path, kill_after: int | None = None
) -> list[TrainingProgress]:
    """The progress of a training, which is killed after ``kill_after`` reports."""
    reported: list[TrainingProgress] = []

    def hear(progress: TrainingProgress) -> None:
        reported.append(progress)
        if len(reported) == kill_after:
            raise Killed

    if kill_after is None:
        train(configuration, out, hear)
    else:
        with pytest.raises(Killed):
            train(configuration, out, hear)
    return reported


def weights(out: Path) -> dict[str, torch.Tensor]:
    return torch.load(out / "checkpoint.pt", weights_only=True)["policy"]


@pytest.mark.slow
def test_a_training_on_the_device_is_complete_and_resumes(
    tmp_path: Path,
) -> None:
    reported = trained(TINY, tmp_path / "whole")
    stages = [
        "imitation, update 1 of 3", "PPO, update 2 of 3", "PPO, update 3 of 3", "evaluation, 1 episodes"
    ]  # fmt: skip
    assert [progress.stage for progress in reported] == stages
    policy = Policy.load(tmp_path / "whole" / "policy.safetensors")
    assert policy.metadata.steps == TINY.steps
    assert policy.action_std == pytest.approx(np.exp(TINY.log_std[1]))
    assert set(policy.metadata.measured) >= {"success_rate", "reward_mean"}
    assert read_configuration(tmp_path / "whole") == TINY
    assert list((tmp_path / "whole" / "tensorboard").rglob("events.out.tfevents.*"))

    trained(TINY, tmp_path / "cut", kill_after=3)
    resume_training(tmp_path / "cut")
    first, second = (
        torch.load(tmp_path / out / "checkpoint.pt", weights_only=True) for out in ("whole", "cut")
    )
    for part in ("policy", "observations", "returns"):
        for name, value in first[part].items():
            assert_array_equal(np.asarray(value), np.asarray(second[part][name]), err_msg=name)
    for one, other in zip(*(each["optimizer"]["state"].values() for each in (first, second)), strict=True):
        assert_array_equal(one["exp_avg"], other["exp_avg"])


def test_imitation_equals_that_on_threads(tmp_path: Path) -> None:
    for engine in ("threads", "warp:cpu"):
        trained(replace(TINY, engine=engine), tmp_path / engine, kill_after=2)
    for name, value in weights(tmp_path / "threads").items():
        assert_array_equal(value, weights(tmp_path / "warp:cpu")[name], err_msg=name)


# Refusals


def refused(tmp_path: Path, *options: str) -> str:
    """What `train` says to that."""
    done = CliRunner().invoke(app, ["train", SCRATCHING, "--out", str(tmp_path / "out"), *options])
    assert done.exit_code == 1
    assert not (tmp_path / "out").exists()
    assert done.stderr.count("\n") == 1
    return done.stderr


def test_a_missing_extra_is_named_with_its_installation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rsl_rl.algorithms", None)
    said = refused(tmp_path, "--engine", "warp:cpu")
    assert "training on the engine warp needs rsl_rl.algorithms; run `pip install avrgym[train,gpu]`" in said


def test_training_without_a_gpu_is_refused(tmp_path: Path) -> None:
    if torch.cuda.is_available():
        pytest.skip("there is a GPU here")
    assert "engine 'warp' needs a CUDA device, and PyTorch finds none" in refused(
        tmp_path, "--engine", "warp"
    )
    assert "has no device 'cuda:1'; allowed: " in refused(tmp_path, "--engine", "warp:cuda:1")


def test_a_cluster_is_refused_with_a_device(tmp_path: Path) -> None:
    class Cluster:
        """Workers that need not be there."""

    with pytest.raises(
        ValueError,
        match="--cluster works only with the engine threads; remove --cluster or --engine warp:cpu",
    ):
        train(TINY, tmp_path / "out", cluster=Cluster())  # pyright: ignore[reportArgumentType]
    assert not (tmp_path / "out").exists()


def test_too_many_worlds_for_the_device_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warp.WarpEngine, "_bytes_per_world", lambda *_: 1 << 30)
    monkeypatch.setattr(warp.WarpEngine, "_free_bytes", lambda _: 5 << 30)
    with pytest.raises(ValueError, match=r"^7 worlds need 7.0 GiB of memory on CPU; allowed: up to 5$"):
        train(replace(TINY, num_envs=7), tmp_path / "out")
    assert not (tmp_path / "out" / "configuration.json").exists()
