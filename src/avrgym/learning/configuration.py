"""What a training run is made of."""

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec

from avrgym.learning.settings_file import settings_of
from avrgym.networks.policy import FILE_SUFFIX
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.populations import carried_people, is_trained
from avrgym.system.engines import THREADS
from avrgym.system.files import write_whole
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.training_settings import TrainingSettings

PEOPLE = "people"
"""Name of a copy of the file of people, or the folder of trained humans, that a training was begun with, if it was."""
CONFIGURATION_FILE, LOG_FOLDER = "configuration.json", "tensorboard"
ADAPTIVE_FILE = "adaptive.json"
"""The same of a training by the recipe ``adaptive``."""
PEOPLE_SUFFIX = ".toml"
LEARNING_VERSION = 2
"""Version of the training algorithm. A training is resumed only by the version that began it."""
PAPER_STEPS = 10_000_000
"""Environment steps of each of the paper's trainings (section VI)."""
PAPER_SETTINGS = TrainingSettings(
    worlds=1024,
    minibatch=5120,
    imitation_rounds=0,
    imitation_share=0.0,
    critic_updates=0,
    log_std=(-0.7, -2.5),
    force_weight_per_n=0.0,
    detour_weight_per_m=0.0,
    hard_share=0.0,
)
"""The paper's recipe, the same for every task: PPO alone, on the task's rewards as they are. The paper says nothing of
how random actions are: they begin and end here as in feeding, which learns by PPO alone, too. Nor does it say how many
episodes an update has: with so many, each finds some of what is rare, and steps are made several times faster."""


@dataclass(frozen=True, kw_only=True)
class Pairing:
    """That a human is trained beside the robot, in the bodies of the people.

    ``alternate`` is for how many updates one learns while the other stays as it is, first the robot; with 0 both learn
    in each. Unless the reward is shared, each pays for its own effort.
    """

    alternate: int = 0
    shared_reward: bool = True


@dataclass(frozen=True, kw_only=True)
class TrainingConfiguration(TrainingSettings):
    """A training run: environment, people, number of environment steps, and recipe."""

    environment: str
    people: str = "original"
    impairment: str = "none"
    steps: int = 2_000_000
    seed: int = 0
    threads: int = 0
    engine: str = THREADS
    learning_version: int = LEARNING_VERSION
    pairing: Pairing | None = None

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

    def actor_learns_at(self, steps: int) -> bool:
        """Whether the actor learns too, or only the critic, which does not know yet what an imitated actor is worth."""
        critic_steps = self.critic_updates * self.update_steps
        return self.imitation_steps == 0 or steps > self.imitation_steps + critic_steps


def turn(configuration: TrainingConfiguration, steps: int) -> tuple[bool, bool]:
    """Whether the robot and the human learn from the update of PPO that begins after so many steps."""
    alternate = 0 if configuration.pairing is None else configuration.pairing.alternate
    if not alternate:
        return True, True
    update = (steps - configuration.imitation_steps) // configuration.update_steps
    return (True, False) if update // alternate % 2 == 0 else (False, True)


def configuration_for(
    environment: str,
    people: str,
    steps: int,
    seed: int,
    impairment: str = "none",
    settings: TrainingSettings | None = None,
    engine: str = THREADS,
    pairing: Pairing | None = None,
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
        pairing=pairing,
        **vars(settings or settings_of(environment)),
    )


def lengthened(configuration: TrainingConfiguration, steps: int) -> TrainingConfiguration:
    """The configuration for more steps, with as much imitation as before."""
    rounds = configuration.imitation_steps // configuration.update_steps
    return replace(configuration, steps=steps, imitation_rounds=rounds, imitation_share=1.0)


def store(configuration: TrainingConfiguration, out: Path) -> None:
    """Write what the training in ``out`` is made of."""
    write_whole(out / CONFIGURATION_FILE, msgspec.json.format(msgspec.json.encode(asdict(configuration))))


def store_people(people: str, out: Path) -> None:
    """Keep a copy of people who have no name in the folder of a training."""
    if people in NAMED_DISTRIBUTIONS:
        return
    kept = out / PEOPLE
    if not Path(people).is_dir():
        kept = kept.with_suffix(FILE_SUFFIX if is_trained(people) else PEOPLE_SUFFIX)
    carried_people(people).write(kept)


def stored_people(configuration: TrainingConfiguration, out: Path) -> str:
    """Name, file or folder of the people of the training in ``out``."""
    if configuration.people in NAMED_DISTRIBUTIONS:
        return configuration.people
    copies = [out / f"{PEOPLE}{suffix}" for suffix in (PEOPLE_SUFFIX, FILE_SUFFIX, "")]
    return str(next((copy for copy in copies if copy.exists()), copies[0]))


def stored_configuration(out: Path) -> TrainingConfiguration:
    """What the training in ``out`` is made of.

    Raises:
        ValueError: when ``out`` holds no training, or one of a later version.
    """
    path = out / CONFIGURATION_FILE
    if (out / ADAPTIVE_FILE).exists():
        raise ValueError(
            f"{out} holds a training by --recipe adaptive; allowed with it: --resume --recipe adaptive"
        )
    if not path.exists():
        raise ValueError(f"{out} holds no training to resume")
    try:
        stored: dict[str, Any] = msgspec.json.decode(path.read_bytes(), type=dict[str, Any])
        configuration = msgspec.convert(stored, TrainingConfiguration)
    except (msgspec.DecodeError, msgspec.ValidationError) as error:
        raise ValueError(f"{path}: {error}") from error
    if (version := stored.get("learning_version")) != LEARNING_VERSION:
        raise ValueError(f"{path}: learning version {version}; allowed: {LEARNING_VERSION}")
    return configuration
