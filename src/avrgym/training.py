"""Training with PPO (Stable-Baselines3) over the native vector environment.

Needs the extra ``train``. What it leaves is a policy file that needs neither of them.
"""

import subprocess
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from avrgym.envs import ACTIONS, AssistiveVectorEnv
from avrgym.evaluation import evaluate
from avrgym.files import write_whole
from avrgym.policies import Policy, PolicyMetadata

Array = NDArray[Any]


POLICY_FILE = "policy.safetensors"
MEASURED_EPISODES = 100


@dataclass(frozen=True)
class TrainingConfiguration:
    """What a training run is made of. Network and algorithm are the paper's (section V); the rest is ours."""

    environment: str
    people: str = "original"
    steps: int = 2_000_000
    seed: int = 0
    worlds: int = 64
    steps_per_update: int = 200
    minibatch: int = 1600
    epochs: int = 10
    learning_rate: float = 3e-4
    discount: float = 0.99
    gae_lambda: float = 0.95
    clip_range: float = 0.2
    initial_log_std: float = -0.7
    hidden: tuple[int, ...] = (64, 64)
    threads: int = 0


class SB3VectorEnv(VecEnv):
    """The native vector environment as Stable-Baselines3 wants it."""

    def __init__(self, env: AssistiveVectorEnv) -> None:
        self.env = env  # the base class asks it for its render mode
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)
        self._actions: Array = np.zeros((env.num_envs, ACTIONS))
        self._seed: int | None = None

    def seed(self, seed: int | None = None) -> list[int | None]:
        self._seed = seed
        return [None if seed is None else seed + i for i in range(self.num_envs)]

    def reset(self) -> Array:
        observation, _ = self.env.reset(seed=self._seed)
        self._seed = None
        return observation

    def step_async(self, actions: Array) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[Array, Array, Array, list[dict[str, Any]]]:
        observation, reward, _, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.nonzero(truncated)[0]:
            infos[i] = {
                "terminal_observation": info["final_obs"][i],
                "TimeLimit.truncated": True,
                "success": bool(info["success"][i]),
            }
        return observation, reward, truncated, infos

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("the worlds share their attributes")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        raise NotImplementedError("the worlds share their methods")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * len(list(self._get_indices(indices)))


class _Progress(BaseCallback):
    """Gathers finished episodes, logs each update, and keeps the policy that did best lately."""

    def __init__(self, configuration: TrainingConfiguration, out: Path) -> None:
        super().__init__()
        self._configuration, self._out = configuration, out
        self._returns = np.zeros(configuration.worlds)
        self._finished: list[tuple[float, bool]] = []
        self._best_reward = -np.inf

    def _on_step(self) -> bool:
        normalised = self.training_env
        assert isinstance(normalised, VecNormalize)
        self._returns += normalised.get_original_reward()
        for i in np.nonzero(self.locals["dones"])[0]:
            self._finished.append((float(self._returns[i]), self.locals["infos"][i]["success"]))
            self._returns[i] = 0.0
        return True

    def _on_rollout_end(self) -> None:
        recent = self._finished[-2 * self._configuration.worlds :]
        if not recent:
            return
        reward, success = (float(np.mean(column)) for column in zip(*recent, strict=True))
        self.logger.record("rollout/reward_mean", reward)
        self.logger.record("rollout/success_rate", success)
        print(f"{self.num_timesteps:>10} steps  reward {reward:8.1f}  success {success:6.1%}", flush=True)
        if reward > self._best_reward:
            self._best_reward = reward
            assert isinstance(self.model, PPO)
            export_policy(self.model, self._configuration).save(self._out / POLICY_FILE, overwrite=True)


def train(configuration: TrainingConfiguration, out: Path) -> Policy:
    """Train, and leave ``policy.safetensors``, ``configuration.json`` and TensorBoard's log in ``out``.

    The policy is the one with the best episodes. It carries what it reaches on people that
    training never saw.

    Raises:
        ValueError: for an unknown environment or people.
        FileExistsError: when ``out`` already holds a training.
    """
    if (out / "configuration.json").exists():
        raise FileExistsError(f"{out} already holds a training; choose another folder")
    env = SB3VectorEnv(
        AssistiveVectorEnv(
            configuration.environment,
            configuration.worlds,
            people=configuration.people,
            num_threads=configuration.threads,
        )
    )
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / "configuration.json", msgspec.json.format(msgspec.json.encode(asdict(configuration))))
    model = _ppo(configuration, env, out)
    model.learn(configuration.steps, callback=_Progress(configuration, out), progress_bar=False)
    env.close()
    return _measure(configuration, out / POLICY_FILE)


def _measure(configuration: TrainingConfiguration, path: Path) -> Policy:
    """Write into a policy's file what it reaches."""
    figures = evaluate(configuration.environment, str(path), configuration.people, MEASURED_EPISODES, seed=0)
    measured = {
        name: getattr(figures, name)
        for name in ("episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")
    }
    policy = Policy.load(path)
    policy = replace(policy, metadata=msgspec.structs.replace(policy.metadata, measured=measured))
    policy.save(path, overwrite=True)
    return policy


def _ppo(configuration: TrainingConfiguration, env: VecEnv, out: Path) -> PPO:
    return PPO(
        "MlpPolicy",
        VecNormalize(env, gamma=configuration.discount, clip_obs=5.0),
        learning_rate=configuration.learning_rate,
        n_steps=configuration.steps_per_update,
        batch_size=configuration.minibatch,
        n_epochs=configuration.epochs,
        gamma=configuration.discount,
        gae_lambda=configuration.gae_lambda,
        clip_range=configuration.clip_range,
        policy_kwargs={
            "net_arch": list(configuration.hidden),
            "activation_fn": torch.nn.Tanh,
            "log_std_init": configuration.initial_log_std,
        },
        tensorboard_log=str(out / "tensorboard"),
        seed=configuration.seed,
        device="cpu",
    )


def export_policy(model: PPO, configuration: TrainingConfiguration) -> Policy:
    """The deterministic actor of a PPO model with its observation normaliser."""
    normaliser = model.get_env()
    assert isinstance(normaliser, VecNormalize)
    actor = model.policy
    layers = [layer for layer in actor.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers.append(actor.action_net)  # type: ignore[arg-type]
    return Policy(
        weights=tuple(layer.weight.detach().numpy().T for layer in layers),
        biases=tuple(layer.bias.detach().numpy() for layer in layers),
        observation_mean=normaliser.obs_rms.mean,  # type: ignore[union-attr]
        observation_variance=normaliser.obs_rms.var,  # type: ignore[union-attr]
        observation_clip=normaliser.clip_obs,
        observation_epsilon=normaliser.epsilon,
        metadata=PolicyMetadata(
            environment=configuration.environment,
            people=configuration.people,
            steps=model.num_timesteps,
            seed=configuration.seed,
            git_commit=_git_commit(),
        ),
    )


def _git_commit() -> str:
    found = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent, check=False
    )
    return found.stdout.strip()
