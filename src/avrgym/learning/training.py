"""Training: imitation of an expert, then PPO (Stable-Baselines3) over the native vector environment.

Needs the extra ``train``. What it leaves is a policy file that needs neither of them.
"""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import shutil
import subprocess
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cache
from math import exp
from pathlib import Path
from typing import Any, cast

import msgspec
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecNormalize

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning import checkpoint
from avrgym.learning.evaluation import evaluate
from avrgym.learning.hard_episodes import HardEpisodes
from avrgym.learning.imitation import imitate
from avrgym.learning.settings_file import settings_of
from avrgym.learning.stable_baselines import (
    ObservationScale,
    SB3VectorEnv,
    finished_episodes,
    go_on_from,
    normaliser_of,
)
from avrgym.people.distributions import NAMED, people_name
from avrgym.policies.trained import Policy, PolicyMetadata
from avrgym.simulation.engines.names import THREADS
from avrgym.system.files import write_whole
from avrgym.system.locks import locked
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.known import EPISODE_STEPS
from avrgym.tasks.training_settings import TrainingSettings

POLICY_FILE, CONFIGURATION_FILE, CHECKPOINT_FILE = "policy.safetensors", "configuration.json", "checkpoint.pt"
LOG_FOLDER = "tensorboard"
SHOWN_FOLDER = "shown"
"""What the expert showed, while the policy imitates it."""
PEOPLE_FILE = "people.toml"
"""A copy of the file of people that a training was begun with, if it was."""
MEASURED_EPISODES = 100
CURVE_POINTS = 100


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration(TrainingSettings):
    """A training run: where, on whom, for how many environment steps, and how."""

    environment: str
    people: str = "original"
    impairment: str = "none"
    steps: int = 2_000_000
    seed: int = 0
    threads: int = 0
    engine: str = THREADS

    @property
    def update_steps(self) -> int:
        """Environment steps of one update: an episode in every world."""
        return self.worlds * EPISODE_STEPS

    @property
    def whole_steps(self) -> int:
        """Environment steps in all, whole updates."""
        return -(-self.steps // self.update_steps) * self.update_steps

    @property
    def imitation_steps(self) -> int:
        """Environment steps of imitation, whole rounds."""
        rounds = min(self.imitation_rounds, int(self.imitation_share * self.steps) // self.update_steps)
        return rounds * self.update_steps

    def _ppo_share(self, steps: float) -> float:
        """What share of PPO is done after so many environment steps in all."""
        return min(1.0, max(0.0, steps - self.imitation_steps) / max(1, self.steps - self.imitation_steps))

    def log_std_at(self, steps: float) -> float:
        """Logarithm of the standard deviation of random actions after so many steps."""
        first, last = self.log_std
        return first + self._ppo_share(steps) * (last - first)

    def learning_rate_at(self, steps: float) -> float:
        """The learning rate after so many steps."""
        return self.learning_rate * max(0.01, 1.0 - self._ppo_share(steps))

    def force_weight_at(self, steps: float) -> float:
        """What each newton takes off the reward after so many steps, 1/N."""
        return self.force_weight_per_n * min(max(3.0 * self._ppo_share(steps) - 1.0, 0.0), 1.0)


def configuration_for(
    environment: str,
    people: str,
    steps: int,
    seed: int,
    impairment: str = "none",
    settings: TrainingSettings | None = None,
    engine: str = THREADS,
) -> TrainingConfiguration:
    """How we train in an environment; ``settings`` stand for the task's own.

    Raises:
        ValueError: for an unknown environment, naming what there is.
    """
    return TrainingConfiguration(
        environment=environment,
        people=people,
        impairment=impairment,
        steps=steps,
        seed=seed,
        engine=engine,
        **vars(settings or settings_of(environment)),
    )


@dataclass(frozen=True)
class Progress:
    """How a training stands: its stage in words, environment steps so far, and how the latest episodes went.

    Mean reward and success are those of the policy's own episodes; None before there are any.
    """

    stage: str
    steps: int
    reward_mean: float | None
    success_rate: float | None


CurvePoint = tuple[int, float, float]
"""Environment steps so far, and mean reward and success of the latest episodes."""
Tell = Callable[[Progress], None]


class _Watch(BaseCallback):
    """Gathers finished episodes, logs each update, and saves policy and checkpoint before the next.

    An update's episodes are whole, so that each checkpoint lies between episodes.
    """

    def __init__(
        self, configuration: TrainingConfiguration, out: Path, env: SB3VectorEnv, tell: Tell
    ) -> None:
        super().__init__()
        self._configuration, self._out, self._env, self._tell = configuration, out, env, tell
        self._finished: list[tuple[float, bool]] = []
        self._curve: list[CurvePoint] = []
        self._hard = HardEpisodes(configuration.worlds, configuration.hard_share, configuration.seed)
        self._seconds_before, self._began = 0.0, time.monotonic()

    @property
    def episodes(self) -> Episodes:
        """The worlds."""
        return self._env.env.episodes

    def resume(self, notes: dict[str, Any]) -> None:
        """Go on from the notes of a checkpoint."""
        self._finished = [(reward, success) for reward, success in notes["finished"]]
        self._curve = [(steps, reward, success) for steps, reward, success in notes["curve"]]
        self._hard.kept = notes.get("hard", [])  # checkpoints of earlier versions know of none
        self._seconds_before = notes["seconds"]

    def hear(self, stage: str, finished: list[tuple[float, bool]]) -> None:
        """Take return and success of episodes that have ended in a stage, and tell how training stands."""
        steps = self.model.num_timesteps
        self._finished = (self._finished + finished)[-2 * self._configuration.worlds :]
        if finished:
            reward, success = (sum(column) / len(column) for column in zip(*self._finished, strict=True))
            self._curve.append((steps, reward, success))
        self.tell(stage)

    def tell(self, stage: str) -> None:
        """Tell how training stands in a stage."""
        reward, success = self._curve[-1][1:] if self._curve else (None, None)
        self._tell(Progress(stage, self.model.num_timesteps, reward, success))

    def imitated(self, finished: list[tuple[float, bool]]) -> None:
        """Save a round of imitation, and tell of what the policy did meanwhile."""
        configuration = self._configuration
        done, rounds = (
            steps // configuration.update_steps
            for steps in (self.model.num_timesteps, configuration.imitation_steps)
        )
        self.hear(f"imitation, round {done} of {rounds}", finished)
        self.save_checkpoint()

    def _on_rollout_start(self) -> None:
        configuration = self._configuration
        if configuration.hard_share > 0.0:
            self._begin_episodes()
        self.save_checkpoint()
        assert isinstance(self.model, PPO)
        with torch.no_grad():
            self.model.policy.log_std.fill_(configuration.log_std_at(self.num_timesteps))
        self._env.force_weight_per_n = configuration.force_weight_at(self.num_timesteps)

    def _begin_episodes(self) -> None:
        """Begin new episodes and hard ones instead of those that the worlds would go on with."""
        assert isinstance(self.model, PPO)
        go_on_from(self.model, self._env.begin([*self._hard.choose(self.num_timesteps)]))

    def save_checkpoint(self) -> None:
        """Save where the training is, between two updates."""
        assert isinstance(self.model, PPO)
        notes = {
            "finished": self._finished,
            "curve": self._curve,
            "hard": self._hard.kept,
            "seconds": self._seconds,
        }
        checkpoint.save(self._out / CHECKPOINT_FILE, self.model, self._env.env, notes)
        policy = export_policy(self.model, self._configuration, self._seconds, self._curve)
        policy.save(self._out / POLICY_FILE, overwrite=True)

    @property
    def _seconds(self) -> float:
        return self._seconds_before + time.monotonic() - self._began

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        assert isinstance(self.model, PPO)
        infos = self.locals["infos"]
        if self._configuration.hard_share > 0.0:
            self._hard.judge(*([info[name] for info in infos] for name in ("success", "episode_force_n")))
        self.hear("PPO", finished_episodes(infos[self._hard.again :]))
        _, reward, success = self._curve[-1]
        self.logger.record("rollout/reward_mean", reward)
        self.logger.record("rollout/success_rate", success)
        self._free_actor(self.model)

    def _free_actor(self, model: PPO) -> None:
        """Let the actor learn too, unless the critic does not know yet what the imitated actor is worth."""
        configuration = self._configuration
        critic_steps = configuration.critic_updates * configuration.update_steps
        imitated = configuration.imitation_steps
        learns = imitated == 0 or self.num_timesteps > imitated + critic_steps
        model.policy.mlp_extractor.policy_net.requires_grad_(learns)
        model.policy.action_net.requires_grad_(learns)


def train(configuration: TrainingConfiguration, out: Path, tell: Tell = lambda progress: None) -> Policy:
    """Train, and leave ``policy.safetensors``, ``configuration.json`` and TensorBoard's log in ``out``.

    The policy carries what it reaches on people that training never saw. A training that is cut off leaves its latest
    policy and checkpoint, from which ``resume`` goes on.

    Args:
        configuration: what to train, on whom, for how long.
        out: a folder that holds no training yet.
        tell: told of the progress after every update.

    Raises:
        ValueError: for an unknown environment or people, or where another training is about to begin in ``out``.
        FileExistsError: when ``out`` already holds a training.
    """
    _refuse_used(out)
    env = _environment(configuration, configuration.people)
    out.mkdir(parents=True, exist_ok=True)
    with locked(out):
        _refuse_used(out)
        if configuration.people not in NAMED:
            write_whole(out / PEOPLE_FILE, Path(configuration.people).read_bytes())
        _store(configuration, out)
        return _begin(configuration, env, out, tell)


def _refuse_used(out: Path) -> None:
    if (out / CONFIGURATION_FILE).exists():
        raise FileExistsError(
            f"{out} already holds a training; choose another folder, or go on with --resume"
        )


def resume(out: Path, tell: Tell = lambda progress: None, steps: int | None = None) -> Policy:
    """Go on with the training in ``out`` from its latest checkpoint, to the same weights as if never cut off.

    One that was cut off before its first checkpoint begins again, with the same seed.

    Args:
        out: the folder of the training.
        tell: told of the progress after every update.
        steps: how many it shall have made in the end, more than so far; without it as many as it was begun with.
            Imitation gets no longer; PPO goes on, its learning rate and chance where a training of so many steps has
            them.

    Raises:
        ValueError: when there is none, when it is complete, when it goes on in another process, or when its files are
            damaged.
    """
    configuration = stored_configuration(out)
    with locked(out):
        if steps is not None and steps != configuration.steps:
            configuration = _extended(configuration, steps, out)
        return _resume(configuration, out, tell)


def _extended(configuration: TrainingConfiguration, steps: int, out: Path) -> TrainingConfiguration:
    """The configuration for so many steps in all, stored."""
    done = Policy.load(out / POLICY_FILE).metadata.steps if (out / POLICY_FILE).exists() else 0
    if steps <= done:
        raise ValueError(f"the training in {out} has made {done} steps; to go on, --steps must be more")
    longer = lengthened(configuration, steps)
    _store(longer, out)
    return longer


def lengthened(configuration: TrainingConfiguration, steps: int) -> TrainingConfiguration:
    """The configuration for more steps, with as much imitation as before."""
    rounds = configuration.imitation_steps // configuration.update_steps
    return replace(configuration, steps=steps, imitation_rounds=rounds, imitation_share=1.0)


def _store(configuration: TrainingConfiguration, out: Path) -> None:
    write_whole(out / CONFIGURATION_FILE, msgspec.json.format(msgspec.json.encode(asdict(configuration))))


def _resume(configuration: TrainingConfiguration, out: Path, tell: Tell) -> Policy:
    env = _environment(configuration, _stored_people(configuration, out))
    if not (out / CHECKPOINT_FILE).exists():
        return _begin(configuration, env, out, tell)
    watch = _Watch(configuration, out, env, tell)
    model = _ppo(configuration, env, out)
    watch.resume(checkpoint.restore(out / CHECKPOINT_FILE, model, env.env))
    if model.num_timesteps >= configuration.steps and Policy.load(out / POLICY_FILE).metadata.measured:
        raise ValueError(
            f"the training in {out} is complete, after {model.num_timesteps} steps; more --steps go on"
        )
    return _go_on(model, configuration, watch, out)


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


def _begin(configuration: TrainingConfiguration, env: SB3VectorEnv, out: Path, tell: Tell) -> Policy:
    return _go_on(_ppo(configuration, env, out), configuration, _Watch(configuration, out, env, tell), out)


def _go_on(model: PPO, configuration: TrainingConfiguration, watch: _Watch, out: Path) -> Policy:
    watch.init_callback(model)
    if model.num_timesteps < configuration.imitation_steps:
        _imitate(model, configuration, watch, out)
    shutil.rmtree(out / SHOWN_FOLDER, ignore_errors=True)
    remaining = configuration.steps - model.num_timesteps
    if remaining > 0:
        model.learn(remaining, callback=watch, reset_num_timesteps=False)
        watch.save_checkpoint()
    watch.tell(f"measuring, {MEASURED_EPISODES} episodes")
    return _measure(configuration, out)


def _imitate(model: PPO, configuration: TrainingConfiguration, watch: _Watch, out: Path) -> None:
    rounds = configuration.imitation_steps // configuration.update_steps
    imitate(model, watch.episodes, rounds, configuration.seed, out / SHOWN_FOLDER, watch.imitated)


def _stored_people(configuration: TrainingConfiguration, out: Path) -> str:
    """Name or file of the people of the training in ``out``."""
    return configuration.people if configuration.people in NAMED else str(out / PEOPLE_FILE)


def _environment(configuration: TrainingConfiguration, people: str) -> SB3VectorEnv:
    native = AssistiveVectorEnv(
        configuration.environment,
        configuration.worlds,
        people=people,
        impairment=configuration.impairment,
        num_threads=configuration.threads,
        engine=configuration.engine,
    )
    env = SB3VectorEnv(native)
    env.detour_weight_per_m = configuration.detour_weight_per_m
    return env


def _measure(configuration: TrainingConfiguration, out: Path) -> Policy:
    """Write into the policy's file what it reaches."""
    path, people = out / POLICY_FILE, _stored_people(configuration, out)
    figures = evaluate(
        configuration.environment,
        str(path),
        people,
        MEASURED_EPISODES,
        seed=0,
        impairment=configuration.impairment,
    )
    measured = {
        name: getattr(figures, name)
        for name in ("episodes", "success_rate", "reward_mean", "reward_std", "force_mean_newton")
    }
    policy = Policy.load(path)
    policy = replace(policy, metadata=msgspec.structs.replace(policy.metadata, measured=measured))
    policy.save(path, overwrite=True)
    return policy


def _ppo(configuration: TrainingConfiguration, env: SB3VectorEnv, out: Path) -> PPO:
    torch.set_num_threads(1)  # so small a network gains nothing from more, and its sums keep their order
    normaliser = VecNormalize(env, gamma=configuration.discount, clip_obs=5.0)
    normaliser.obs_rms = ObservationScale(env.env.episodes.observation)
    model = PPO(
        "MlpPolicy",
        normaliser,
        learning_rate=lambda remaining: configuration.learning_rate_at(
            (1.0 - remaining) * configuration.steps
        ),
        n_steps=EPISODE_STEPS,
        batch_size=configuration.minibatch,
        n_epochs=configuration.epochs,
        gamma=configuration.discount,
        gae_lambda=configuration.gae_lambda,
        clip_range=configuration.clip_range,
        policy_kwargs={
            "net_arch": list(configuration.hidden),
            "activation_fn": torch.nn.Tanh,
        },
        tensorboard_log=str(out / LOG_FOLDER),
        seed=configuration.seed,
        device="cpu",
    )
    model.policy.log_std.requires_grad_(False)
    return model


def export_policy(
    model: PPO, configuration: TrainingConfiguration, seconds: float, curve: list[CurvePoint]
) -> Policy:
    """The actor of a PPO model with its observation normaliser and the chance of this stage of training.

    ``seconds`` it was trained for; of the ``curve`` a hundred points are kept.
    """
    normaliser, steps = normaliser_of(model), cast(int, model.num_timesteps)
    actor = model.policy
    layers = [layer for layer in actor.mlp_extractor.policy_net if isinstance(layer, torch.nn.Linear)]
    layers.append(actor.action_net)  # type: ignore[arg-type]
    stride = -(-len(curve) // CURVE_POINTS) or 1
    return Policy(
        weights=tuple(layer.weight.detach().numpy().T for layer in layers),
        biases=tuple(layer.bias.detach().numpy() for layer in layers),
        observation_mean=normaliser.obs_rms.mean,  # type: ignore[union-attr]
        observation_variance=normaliser.obs_rms.var,  # type: ignore[union-attr]
        observation_clip=normaliser.clip_obs,
        observation_epsilon=normaliser.epsilon,
        action_deviation=exp(configuration.log_std_at(steps)),
        metadata=PolicyMetadata(
            environment=configuration.environment,
            people=people_name(configuration.people),
            impairment=configuration.impairment,
            steps=steps,
            seed=configuration.seed,
            git_commit=_git_commit(),
            seconds=round(seconds, 1),
            curve=curve[::-stride][::-1],
        ),
    )


@cache
def _git_commit() -> str:
    found = subprocess.run(
        ["git", "rev-parse", "HEAD"], capture_output=True, text=True, cwd=Path(__file__).parent, check=False
    )
    return found.stdout.strip()
