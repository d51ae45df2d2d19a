"""Training with PPO (Stable-Baselines3) over the native vector environment.

Needs the extra ``train``. What it leaves is a policy file that needs neither of them.
"""

import subprocess
from collections.abc import Callable
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

from avrgym import checkpoint
from avrgym.envs import ACTIONS, AssistiveVectorEnv
from avrgym.episodes import EPISODE_STEPS
from avrgym.evaluation import evaluate
from avrgym.files import write_whole
from avrgym.policies import Policy, PolicyMetadata

Array = NDArray[Any]


POLICY_FILE, CONFIGURATION_FILE, CHECKPOINT_FILE = "policy.safetensors", "configuration.json", "checkpoint.pt"
MEASURED_EPISODES = 100


@dataclass(frozen=True)
class TrainingConfiguration:
    """What a training run is made of. Network and algorithm are the paper's (section V); the rest is ours."""

    environment: str
    people: str = "original"
    steps: int = 2_000_000
    seed: int = 0
    worlds: int = 64
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


@dataclass(frozen=True)
class Progress:
    """How a training stands: environment steps so far, and mean reward and success of the latest episodes."""

    steps: int
    reward_mean: float
    success_rate: float


Tell = Callable[[Progress], None]


class _Watch(BaseCallback):
    """Gathers finished episodes, logs each update, keeps the policy that did best lately, and saves checkpoints.

    An update's episodes are whole, so that each checkpoint lies between episodes.
    """

    def __init__(
        self, configuration: TrainingConfiguration, out: Path, native: AssistiveVectorEnv, tell: Tell
    ) -> None:
        super().__init__()
        self._configuration, self._out, self._native, self._tell = configuration, out, native, tell
        self._returns = np.zeros(configuration.worlds)
        self._finished: list[tuple[float, bool]] = []
        self._best_reward: float | None = None

    def resume(self, notes: dict[str, Any]) -> None:
        """Go on from the notes of a checkpoint."""
        self._finished = [(reward, success) for reward, success in notes["finished"]]
        self._best_reward = notes["best_reward"]

    def _on_rollout_start(self) -> None:
        self.save_checkpoint()

    def save_checkpoint(self) -> None:
        """Save where the training is, between two updates."""
        assert isinstance(self.model, PPO)
        notes = {"finished": self._recent, "best_reward": self._best_reward}
        checkpoint.save(self._out / CHECKPOINT_FILE, self.model, self._native, notes)

    @property
    def _recent(self) -> list[tuple[float, bool]]:
        return self._finished[-2 * self._configuration.worlds :]

    def _on_step(self) -> bool:
        normalised = self.training_env
        assert isinstance(normalised, VecNormalize)
        self._returns += normalised.get_original_reward()
        for i in np.nonzero(self.locals["dones"])[0]:
            self._finished.append((float(self._returns[i]), self.locals["infos"][i]["success"]))
            self._returns[i] = 0.0
        return True

    def _on_rollout_end(self) -> None:
        reward, success = (float(np.mean(column)) for column in zip(*self._recent, strict=True))
        self.logger.record("rollout/reward_mean", reward)
        self.logger.record("rollout/success_rate", success)
        self._tell(Progress(self.num_timesteps, reward, success))
        if self._best_reward is None or reward > self._best_reward:
            self._best_reward = reward
            assert isinstance(self.model, PPO)
            export_policy(self.model, self._configuration).save(self._out / POLICY_FILE, overwrite=True)


def train(configuration: TrainingConfiguration, out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Train, and leave ``policy.safetensors``, ``configuration.json`` and TensorBoard's log in ``out``.

    The policy is the one with the best episodes. It carries what it reaches on people that
    training never saw. A training that is cut off leaves its latest checkpoint, from which ``resume`` goes on.

    Args:
        configuration: what to train, on whom, for how long.
        out: a folder that holds no training yet.
        tell: told of the progress after every update.

    Raises:
        ValueError: for an unknown environment or people.
        FileExistsError: when ``out`` already holds a training.
    """
    if (out / CONFIGURATION_FILE).exists():
        raise FileExistsError(f"{out} already holds a training; choose another folder, or resume it")
    native = _environment(configuration)
    out.mkdir(parents=True, exist_ok=True)
    write_whole(out / CONFIGURATION_FILE, msgspec.json.format(msgspec.json.encode(asdict(configuration))))
    watch = _Watch(configuration, out, native, tell)
    return _learn(_ppo(configuration, SB3VectorEnv(native), out), configuration, watch, out)


def resume(out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Go on with the training in ``out`` from its latest checkpoint, to the same weights as if never cut off.

    Raises:
        ValueError: when there is none, when it is complete, or when its files are damaged.
    """
    configuration = stored_configuration(out)
    if not (out / CHECKPOINT_FILE).exists():
        raise ValueError(f"{out} holds no checkpoint; begin the training anew in another folder")
    native = _environment(configuration)
    watch = _Watch(configuration, out, native, tell)
    model = _ppo(configuration, SB3VectorEnv(native), out)
    watch.resume(checkpoint.restore(out / CHECKPOINT_FILE, model, native))
    if model.num_timesteps >= configuration.steps and Policy.load(out / POLICY_FILE).metadata.measured:
        raise ValueError(f"the training in {out} is complete, after {model.num_timesteps} steps")
    return _learn(model, configuration, watch, out)


def stored_configuration(out: Path) -> TrainingConfiguration:
    """What the training in ``out`` is made of.

    Raises:
        ValueError: when ``out`` holds no training.
    """
    path = out / CONFIGURATION_FILE
    if not path.exists():
        raise ValueError(f"{out} holds no training to resume")
    try:
        return msgspec.json.decode(path.read_bytes(), type=TrainingConfiguration)
    except msgspec.DecodeError as error:
        raise ValueError(f"{path}: {error}") from error


def _learn(model: PPO, configuration: TrainingConfiguration, watch: _Watch, out: Path) -> Policy:
    remaining = configuration.steps - model.num_timesteps
    if remaining > 0:
        model.learn(remaining, callback=watch, reset_num_timesteps=False)
        watch.save_checkpoint()
    return _measure(configuration, out / POLICY_FILE)


def _environment(configuration: TrainingConfiguration) -> AssistiveVectorEnv:
    return AssistiveVectorEnv(
        configuration.environment,
        configuration.worlds,
        people=configuration.people,
        num_threads=configuration.threads,
    )


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
        n_steps=EPISODE_STEPS,
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
