"""All random streams of the program, and their seeds.

Most functions return a random generator. It is seeded by the user's seed, further numbers (such as that of an episode
or update), and often a constant that separates it from other streams with the same seed. Hyperparameters, exploration
noise and checkpoints are selected with episodes of the validation split. Reported results are from the test split. For
every seed, the episodes of both splits differ from those of training: only the splits have a spawn key (NumPy's
``SeedSequence``).
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
"""Function that returns a generator of exploration noise. Arguments: seed, number of past environment steps, world."""


def split_of(name: str) -> Split:
    """Returns the split with this name.

    Raises:
        ValueError: for an unknown name; the message lists the allowed names.
    """
    for split in SPLITS:
        if split == name:
            return split
    raise ValueError(f"unknown split {name!r}; allowed: {', '.join(SPLITS)}")


# Evaluation


def evaluation_episodes(split: Split, seed: int, numbers: Iterable[int]) -> list[Generator]:
    """Person, initial state and exploration noise of each episode in ``numbers``, for the validation or test split."""
    key = (_SPAWN_KEYS[split],)
    return [default_rng(SeedSequence([seed, number], spawn_key=key)) for number in numbers]


# Training


def training_episode(seed: int) -> Generator:
    """Person and initial state of an episode; ``seed`` comes from ``episode_seeds`` or ``hard_episodes``."""
    return default_rng(seed)


def episode_seeds(seed: int, update: int) -> Generator:
    """Seeds of the episodes in one update of a recurrent policy."""
    return default_rng([seed, 1, update])


def imitation(seed: int, update: int) -> Generator:
    """Choice of the worlds that the expert controls in one update, then the update's minibatches."""
    return default_rng([seed, 2, update])


def hard_episodes(seed: int, steps: int) -> Generator:
    """Seeds of the new and the repeated episodes in one update of a feed-forward policy."""
    return default_rng([seed, 3, steps])


def robot_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of the robot's actions in one update."""
    return default_rng([seed, 4, steps, world])


def human_noise(seed: int, steps: int, world: int) -> Generator:
    """Exploration noise of a trained human's actions in one update."""
    return default_rng([seed, 5, steps, world])


def device_minibatches(seed: int, steps: int) -> int:
    """Seed of PyTorch for the minibatches of one update on a device."""
    return int(default_rng([seed, 6, steps]).integers(2**63))


# Single episodes, environments and people; Gymnasium's environments have their own ``np_random``


def episode(seed: int) -> Generator:
    """Initial state and exploration noise of one episode of a study's trial, ``view``, ``export`` or the check of a
    task."""
    return default_rng(seed)


def trained_human_noise(uniform: float) -> Generator:
    """Exploration noise of a trained human in one episode. ``uniform`` is a random number of the initial state, 0 to
    1."""
    return default_rng([5, int(uniform * 2**53)])


def benchmark_actions(seed: int) -> Generator:
    """Random actions of ``bench sim``."""
    return default_rng(seed)


def benchmark_episode(seed: int, world: int) -> Generator:
    """Person and initial state of a world in ``bench sim``."""
    return default_rng([seed, world])


def untrained_weights() -> Generator:
    """Weights of the untrained network of ``bench vr``."""
    return default_rng(0)


def planner_starts() -> Generator:
    """Initial joint angles for the experts' motion planner."""
    return default_rng(0)


def surface_points() -> Generator:
    """Points on the surfaces of bodies in a Foxglove replay."""
    return default_rng(0)


# Studies; ``seed`` is the design's seed. Participant numbers are smaller than the numbers of the named streams


def condition_orders(seed: int) -> Generator:
    """Orders of tasks and conditions."""
    return default_rng(seed)


def trial_seeds(seed: int, participant: int, site: str | None) -> Generator:
    """Seeds of all trials of a participant."""
    return default_rng([seed, participant, *(site or "").encode()])


def practice_robots(seed: int, group: int) -> Generator:
    """Practice robots of a group of participants."""
    return default_rng([seed, 2**32 - 1, group])


def site_cells(seed: int, site: str) -> Generator:
    """The order in which a site fills the cells of the design."""
    return default_rng([seed, 2**32 - 2, *site.encode()])


def policy_codes(seed: int, policies: int) -> Generator:
    """Code letters of the policies for a blinded experimenter."""
    return default_rng([seed, policies])


def item_order(seed: int) -> Generator:
    """Order of a questionnaire's items after a trial; ``seed`` is the trial's seed."""
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


def participant_commands(seed: int, part: int) -> Generator:
    """Commands of a simulated participant to the robot. ``part``: 0 traits, 1 commands of a trial."""
    return default_rng([seed, 4, part])


def participant_noise(seed: int) -> Generator:
    """Exploration noise of a simulated participant that is a trained human."""
    return default_rng([seed, 3])


# Statistics


def simulated_study(seed: int, study: int, part: int) -> Generator:
    """A simulated study of ``study power``. ``part``: 0 answers, 1 tasks, 2 withdrawals, 3 objective results."""
    return default_rng([seed, study, part])


def permutations(seed: int) -> Generator:
    """Permutations of the energy test."""
    return default_rng(seed)


def sampled_sign_flips() -> Generator:
    """Sampled sign flips of paired tests with many participants."""
    return default_rng(0)


def sampled_arm_poses() -> Generator:
    """Random poses of an arm, for the search of links that can collide."""
    return default_rng(0)


def fitted_partners() -> Generator:
    """Behaviour parameters of a fitted population."""
    return default_rng(0)


TRAINING_PEOPLE_SEED = 2020
"""Seed of the sampled training populations, and of the permutations in their comparison with participants."""


def training_people(population: int, task: int) -> Generator:
    """People sampled from a training population, for comparison with participants."""
    return default_rng([TRAINING_PEOPLE_SEED, population, task])
