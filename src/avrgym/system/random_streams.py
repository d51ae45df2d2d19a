"""Every random stream of the program: its use, and the numbers that seed it.

Each function returns a stream for a seed that a user gives, and for the numbers of an episode or an update. A stream's
own number keeps it apart from the others with the same seed. Choices such as hyperparameters, exploration noise and
checkpoints are made with episodes of the validation split; reported results come from the test split. NumPy's
``SeedSequence`` keeps both apart from training, whatever the seeds are: only they have a spawn key.
"""

from collections.abc import Callable, Iterable
from typing import Literal

from numpy.random import Generator, SeedSequence, default_rng

Split = Literal["validation", "test"]
VALIDATION: Split = "validation"
TEST: Split = "test"
SPLITS: tuple[Split, ...] = (VALIDATION, TEST)
_SPAWN_KEYS: dict[Split, int] = {VALIDATION: 1, TEST: 2}

NoiseStream = Callable[[int, int, int], Generator]
"""A stream of exploration noise: of a training's seed, its steps so far, and a world."""


def split_of(name: str) -> Split:
    """The split of a name.

    Raises:
        ValueError: for an unknown name, naming the known ones.
    """
    for split in SPLITS:
        if split == name:
            return split
    raise ValueError(f"unknown split {name!r}; allowed: {', '.join(SPLITS)}")


# Evaluation


def evaluation_episodes(split: Split, seed: int, numbers: Iterable[int]) -> list[Generator]:
    """People, starts and exploration noise of episodes of the validation or test split."""
    key = (_SPAWN_KEYS[split],)
    return [default_rng(SeedSequence([seed, number], spawn_key=key)) for number in numbers]


# Training


def training_episode(seed: int) -> Generator:
    """People and start of an episode; ``seed`` comes from ``episode_seeds`` or ``hard_episodes``."""
    return default_rng(seed)


def episode_seeds(seed: int, update: int) -> Generator:
    """Seeds of the episodes in an update of a recurrent policy."""
    return default_rng([seed, 1, update])


def imitation(seed: int, update: int) -> Generator:
    """Worlds that the expert drives in an update, then the update's minibatches."""
    return default_rng([seed, 2, update])


def hard_episodes(seed: int, steps: int) -> Generator:
    """Seeds of the episodes in an update of a feed-forward policy, new and repeated ones."""
    return default_rng([seed, 3, steps])


def robot_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of the robot's actions in an update."""
    return default_rng([seed, 4, steps, world])


def human_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of a trained human's actions in an update."""
    return default_rng([seed, 5, steps, world])


def device_minibatches(seed: int, steps: int) -> int:
    """Seed of PyTorch for the minibatches of an update on a device."""
    return int(default_rng([seed, 6, steps]).integers(2**63))


# Single episodes, environments and people; Gymnasium's environments have their own ``np_random``


def episode(seed: int) -> Generator:
    """Start and exploration noise of one episode: a study's trial, ``view``, ``export`` and checks of tasks."""
    return default_rng(seed)


def trained_human_noise(uniform: float) -> Generator:
    """Exploration noise of a trained human in an episode, from a uniform number of the episode's start."""
    return default_rng([5, int(uniform * 2**53)])


def benchmark_actions(seed: int) -> Generator:
    """Actions of ``bench sim``."""
    return default_rng(seed)


def benchmark_episode(seed: int, world: int) -> Generator:
    """People and start of a world in ``bench sim``."""
    return default_rng([seed, world])


def untrained_weights() -> Generator:
    """Weights of the network of ``bench vr``."""
    return default_rng(0)


def planner_starts() -> Generator:
    """Joint angles at which the experts' motion planner starts its search."""
    return default_rng(0)


def surface_points() -> Generator:
    """Points on the bodies' surfaces in a replay for Foxglove."""
    return default_rng(0)


# Studies; ``seed`` is that of the design. Participants' numbers stay below those of the named streams


def condition_orders(seed: int) -> Generator:
    """Orders of tasks and conditions."""
    return default_rng(seed)


def trial_seeds(seed: int, participant: int, site: str | None) -> Generator:
    """Seeds of a participant's trials."""
    return default_rng([seed, participant, *(site or "").encode()])


def practice_robots(seed: int, group: int) -> Generator:
    """Robots that a group of participants practises with."""
    return default_rng([seed, 2**32 - 1, group])


def site_cells(seed: int, site: str) -> Generator:
    """The order in which a site fills the cells of the design."""
    return default_rng([seed, 2**32 - 2, *site.encode()])


def policy_codes(seed: int, policies: int) -> Generator:
    """Letters of the policies for a blinded experimenter."""
    return default_rng([seed, policies])


def item_order(seed: int) -> Generator:
    """The order of a questionnaire's items after a trial; ``seed`` is that of the trial."""
    return default_rng(seed)


# Simulated participants


def simulated_answers(seed: int, participant: int) -> Generator:
    """Age, sex and answers of a participant in ``study simulate``."""
    return default_rng([seed, participant])


def participant_traits(seed: int) -> Generator:
    """Body, behaviour and leniency of a simulated participant."""
    return default_rng(seed)


def participant_motion(seed: int) -> Generator:
    """Room, motion and reactions of a simulated participant."""
    return default_rng([seed, 1])


def participant_behaviour(seed: int) -> Generator:
    """Parameters of a simulated participant's behaviour model."""
    return default_rng([seed, 2])


def participant_noise(seed: int) -> Generator:
    """Exploration noise of a simulated participant who is a trained human."""
    return default_rng([seed, 3])


# Statistics


def simulated_study(seed: int, study: int, part: int) -> Generator:
    """A simulated study of ``study power``; parts: 0 answers, 1 tasks, 2 withdrawals, 3 objective results."""
    return default_rng([seed, study, part])


def permutations(seed: int) -> Generator:
    """Permutations of the energy-distance test."""
    return default_rng(seed)


def sampled_sign_flips() -> Generator:
    """Sampled sign flips of paired tests with many participants."""
    return default_rng(0)


TRAINING_PEOPLE_SEED = 2020
"""The seed of the people that participants are compared with, and of the permutations of this comparison."""


def training_people(population: int, task: int) -> Generator:
    """Sampled people of a training population, for comparison with participants."""
    return default_rng([TRAINING_PEOPLE_SEED, population, task])
