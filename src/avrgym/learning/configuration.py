"""Configurations of training runs: environment, people, number of steps, and hyperparameters."""

from abc import abstractmethod
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import msgspec

from avrgym.learning.hyperparameters import (
    RECURRENT_HYPERPARAMETERS,
    VISUAL_HYPERPARAMETERS,
    FeedforwardHyperparameters,
    make_hyperparameters,
)
from avrgym.networks.policy import POLICY_FILE_SUFFIX
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.motor_model import MOTION_VERSION
from avrgym.people.population_names import ORIGINAL_POPULATION, REVISED_POPULATION, TRAIN_ZOO
from avrgym.people.populations import is_trained_human, read_people_for_workers
from avrgym.system.engine_names import THREADS
from avrgym.system.files import write_atomically
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings

FEEDFORWARD_CONFIGURATION_FILE = "configuration.json"
RECURRENT_CONFIGURATION_FILE = "adaptive.json"
"""Name of the configuration file of a training run with the recipe ``adaptive``."""
VISUAL_CONFIGURATION_FILE = "visual.json"
"""Name of the configuration file of a training run with the recipe ``visual``."""
STORED_PEOPLE_NAME, PEOPLE_FILE_SUFFIX = "people", ".toml"
"""Name and suffix of the copy of the people in a training run's folder: a people file, or a folder of trained humans.
"""
TRAINING_ALGORITHM_VERSION = 2
"""Version of the training algorithm. A training run is resumed only with the version that started it."""
RENAMED_CONFIGURATION_KEYS = {
    "worlds": "num_envs",
    "minibatch": "batch_size",
    "epochs": "n_epochs",
    "discount": "gamma",
    "hidden": "net_arch",
    "memory": "memory_size",
}
"""Maps configuration keys in files of AVR Gym 0.2 to the current keys."""


@dataclass(frozen=True, kw_only=True)
class JointTrainingSettings:
    """Settings of joint training: robot and human both learn. The human's bodies are drawn from the population.

    If ``alternate`` is 0, both agents learn in each update. Otherwise only one agent learns at a time, for
    ``alternate`` updates; the robot learns first. If ``shared_reward`` is false, each agent's reward contains only the
    agent's own action penalty.
    """

    alternate: int = 0
    shared_reward: bool = True


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration:
    """Settings that all recipes have. ``steps`` is the number of environment steps, rounded up to whole updates.

    ``threads`` is the number of threads that step the worlds; 0 means one per core. If ``force_guard`` is true, the
    force guard limits the robot during training. If ``withdraw_after_success`` is true, the robot withdraws its tool
    after success. ``settings`` are settings of the environment. ``motion_version`` is the version of the motion model
    for populations without a version in their name. ``preference_weights`` are weights of an additional reward, see
    ``preference_reward``.
    """

    environment: str
    people: str
    steps: int
    num_envs: int
    seed: int = 0
    threads: int = 0
    force_guard: bool = False
    withdraw_after_success: bool = False
    settings: Settings = DEFAULT_SETTINGS
    episode_steps: int = EPISODE_STEPS
    motion_version: int = MOTION_VERSION
    preference_weights: dict[str, float] = field(default_factory=dict[str, float])

    @property
    def steps_per_update(self) -> int:
        """Returns the number of environment steps in one update: an episode in every world."""
        return self.num_envs * self.episode_steps

    @property
    def total_updates(self) -> int:
        """Returns the total number of updates: imitation and PPO."""
        return -(-self.steps // self.steps_per_update)

    @property
    def total_steps(self) -> int:
        """Returns the total number of environment steps: ``steps``, rounded up to whole updates."""
        return self.total_updates * self.steps_per_update

    @property
    @abstractmethod
    def imitation_updates(self) -> int:
        """Returns the number of imitation updates. They are the first updates of a training run."""

    @property
    def imitation_steps(self) -> int:
        """Returns the number of environment steps in the imitation updates."""
        return self.imitation_updates * self.steps_per_update

    @abstractmethod
    def with_steps(self, steps: int) -> Self:
        """Returns the configuration with another number of steps and the same number of imitation updates.

        Raises:
            ValueError: if ``steps`` is smaller than before and the recipe does not allow this.
        """


@dataclass(frozen=True, kw_only=True)
class FeedforwardConfiguration(FeedforwardHyperparameters, TrainingConfiguration):
    """Settings of the training of a robot's feed-forward policy. If ``pairing`` is set, robot and human are trained
    together.
    """

    people: str = ORIGINAL_POPULATION
    impairment: str = "none"
    steps: int = 2_000_000
    engine: str = THREADS
    learning_version: int = TRAINING_ALGORITHM_VERSION
    pairing: JointTrainingSettings | None = None

    @property
    def imitation_updates(self) -> int:
        return min(self.imitation_rounds, int(self.imitation_share * self.steps) // self.steps_per_update)

    def with_steps(self, steps: int) -> Self:
        return replace(self, steps=steps, imitation_rounds=self.imitation_updates, imitation_share=1.0)

    def _ppo_progress(self, steps: float) -> float:
        """Returns the completed share of PPO's environment steps, 0 to 1, after ``steps`` steps in total."""
        return min(1.0, max(0.0, steps - self.imitation_steps) / max(1, self.steps - self.imitation_steps))

    def compute_log_std(self, steps: float) -> float:
        """Returns the natural logarithm of the action standard deviation after ``steps`` environment steps."""
        first, last = self.log_std
        return first + self._ppo_progress(steps) * (last - first)

    def compute_learning_rate(self, steps: float) -> float:
        """Returns PPO's learning rate after ``steps`` environment steps."""
        return self.learning_rate * max(0.01, 1.0 - self._ppo_progress(steps))

    def compute_force_weight(self, steps: float) -> float:
        """Returns the reward penalty per newton of force on the person after ``steps`` environment steps."""
        return self.force_weight_per_n * min(max(3.0 * self._ppo_progress(steps) - 1.0, 0.0), 1.0)

    def is_actor_learning(self, steps: int) -> bool:
        """Returns whether the actor learns after ``steps`` environment steps. In the first ``critic_updates`` updates
        after imitation, only the critic learns."""
        critic_steps = self.critic_updates * self.steps_per_update
        return self.imitation_steps == 0 or steps > self.imitation_steps + critic_steps

    def find_learning_agents(self, steps: int) -> tuple[bool, bool]:
        """Returns whether the robot learns, and whether the human learns, in the PPO update that starts after
        ``steps``."""
        alternate = 0 if self.pairing is None else self.pairing.alternate
        if not alternate:
            return True, True
        update = (steps - self.imitation_steps) // self.steps_per_update
        return (True, False) if update // alternate % 2 == 0 else (False, True)


@dataclass(frozen=True, kw_only=True)
class RecurrentConfiguration(TrainingConfiguration):
    """Settings of the training of a recurrent policy.

    The first updates imitate the task's expert, or the policy ``teacher`` (name or file). ``initial`` is a recurrent
    policy (name or file) with the initial weights; its layer sizes replace ``memory_size`` and ``net_arch``.
    ``imitation_share`` is ``RECURRENT_HYPERPARAMETERS.imitation_share`` by default, or 0 if there is an initial policy.
    """

    people: str = TRAIN_ZOO
    steps: int = 1_280_000
    imitation_share: float | None = None
    num_envs: int = 64
    memory_size: int = 128
    net_arch: tuple[int, ...] = (128, 128)
    teacher: str | None = None
    initial: str | None = None

    @property
    def imitation_updates(self) -> int:
        least, share = (1, RECURRENT_HYPERPARAMETERS.imitation_share) if self.initial is None else (0, 0.0)
        if self.imitation_share is not None:
            share = self.imitation_share
        return max(least, round(share * self.total_updates))

    def with_steps(self, steps: int) -> Self:
        longer = replace(self, steps=steps)
        if longer.total_updates < self.total_updates:
            raise ValueError(
                f"--steps is {steps}, but the training run has {self.steps} steps; allowed: {self.steps} or more"
            )
        return replace(longer, imitation_share=self.imitation_updates / longer.total_updates)

    def compute_ppo_progress(self, update: int) -> float:
        """Returns the completed share of PPO's updates, 0 to 1, before the update with this number. It is 0 while only
        the critic learns.
        """
        first = self.imitation_updates + RECURRENT_HYPERPARAMETERS.critic_only_updates
        return max(0.0, (update - first) / max(1, self.total_updates - first))


@dataclass(frozen=True, kw_only=True)
class VisualConfiguration(TrainingConfiguration):
    """Settings of the training of a policy with vision.

    The policy imitates ``teacher`` (name or file of a policy). Its observations contain images of ``camera``, see
    ``models.cameras``.
    """

    people: str = REVISED_POPULATION
    steps: int = 20_480
    num_envs: int = 128
    threads: int = 1
    teacher: str = "revised"
    camera: str = "wrist:64x64:depth"

    @property
    def steps_per_update(self) -> int:
        return self.num_envs * VISUAL_HYPERPARAMETERS.episode_steps

    @property
    def imitation_updates(self) -> int:
        return self.total_updates

    def with_steps(self, steps: int) -> Self:
        return replace(self, steps=steps)


AnyTrainingConfiguration = FeedforwardConfiguration | RecurrentConfiguration | VisualConfiguration


def make_feedforward_configuration(
    environment: str,
    people: str,
    steps: int,
    seed: int,
    impairment: str = "none",
    hyperparameters: FeedforwardHyperparameters | None = None,
    engine: str = THREADS,
    pairing: JointTrainingSettings | None = None,
    **others: Any,
) -> FeedforwardConfiguration:
    """Returns the settings for training a feed-forward policy. By default, hyperparameters are those of the task.

    Raises:
        ValueError: for an unknown environment. The message contains the allowed ids.
    """
    return FeedforwardConfiguration(
        environment=environment,
        people=people,
        impairment=impairment,
        steps=steps,
        seed=seed,
        engine=engine,
        pairing=pairing,
        **others,
        **vars(hyperparameters or make_hyperparameters(environment)),
    )


def write_configuration(configuration: AnyTrainingConfiguration, out: Path) -> None:
    """Write a configuration as JSON into the folder ``out`` of its training run."""
    files: dict[type, str] = {
        RecurrentConfiguration: RECURRENT_CONFIGURATION_FILE,
        VisualConfiguration: VISUAL_CONFIGURATION_FILE,
    }
    path = out / files.get(type(configuration), FEEDFORWARD_CONFIGURATION_FILE)
    write_atomically(path, msgspec.json.format(msgspec.json.encode(asdict(configuration))))


def contains_training_run(out: Path) -> bool:
    """Returns whether the folder ``out`` contains the configuration file of a training run."""
    return any(
        (out / name).exists()
        for name in (FEEDFORWARD_CONFIGURATION_FILE, RECURRENT_CONFIGURATION_FILE, VISUAL_CONFIGURATION_FILE)
    )


def read_configuration(out: Path) -> AnyTrainingConfiguration:
    """Read and return the configuration of the training run in the folder ``out``.

    Files of AVR Gym 0.2 are accepted. In such training runs, people use version 1 of the motion model.

    Raises:
        ValueError: if ``out`` contains no training run, or one with another learning version.
    """
    if not contains_training_run(out):
        raise ValueError(f"{out} contains no training run; allowed: the --out folder of `avrgym train`")
    kinds = {
        RECURRENT_CONFIGURATION_FILE: RecurrentConfiguration,
        VISUAL_CONFIGURATION_FILE: VisualConfiguration,
        FEEDFORWARD_CONFIGURATION_FILE: FeedforwardConfiguration,
    }
    path, kind = next((out / name, kind) for name, kind in kinds.items() if (out / name).exists())
    try:
        stored: dict[str, Any] = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        configuration = msgspec.convert(
            {RENAMED_CONFIGURATION_KEYS.get(key, key): value for key, value in stored.items()}, kind
        )
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise ValueError(f"{path}: {error}") from error
    if "motion_version" not in stored and _people_move(configuration):
        configuration = replace(configuration, people=f"{configuration.people}@1")
    version = (
        stored.get("learning_version") if kind is FeedforwardConfiguration else TRAINING_ALGORITHM_VERSION
    )
    if version != TRAINING_ALGORITHM_VERSION:
        raise ValueError(
            f"{path}: the training run has learning version {version}; allowed: {TRAINING_ALGORITHM_VERSION}. Start "
            f"a new "
            "training run, or resume it with the AVR Gym version that started it"
        )
    return configuration


def _people_move(configuration: AnyTrainingConfiguration) -> bool:
    """Returns whether the people of a training run move. Returns ``False`` if the population's name contains a motion
    version, as in ``participants@1``.
    """
    named = NAMED_DISTRIBUTIONS.get(configuration.people)
    if named is None or "@" in configuration.people:
        return False
    return (
        named.is_moving
        or not isinstance(configuration, FeedforwardConfiguration)
        or configuration.impairment != "none"
    )


def store_people(people: str, out: Path) -> None:
    """Copy a people file, or trained humans, into the folder of a training run."""
    if people in NAMED_DISTRIBUTIONS:
        return
    copy = out / STORED_PEOPLE_NAME
    if not Path(people).is_dir():
        copy = copy.with_suffix(POLICY_FILE_SUFFIX if is_trained_human(people) else PEOPLE_FILE_SUFFIX)
    read_people_for_workers(people).write(copy)


def find_stored_people(people: str, out: Path) -> str:
    """Returns ``people`` if it is the name of a population, otherwise the path of their copy in the folder ``out``."""
    if people in NAMED_DISTRIBUTIONS:
        return people
    copies = [
        out / f"{STORED_PEOPLE_NAME}{suffix}" for suffix in (PEOPLE_FILE_SUFFIX, POLICY_FILE_SUFFIX, "")
    ]
    return str(next((copy for copy in copies if copy.exists()), copies[0]))
