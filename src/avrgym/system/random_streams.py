"""All random streams of the program, and their seeds.

Most functions return a random generator. Its seed consists of the user's seed and further numbers, such as the number
of an episode or update. Many seeds contain a constant that separates streams with the same user's seed.

Hyperparameters, exploration noise and checkpoints are selected with episodes of the validation split. Reported results
are from the test split. For every seed, the episodes of both splits differ from those of training: only the splits have
a spawn key (NumPy's ``SeedSequence``).
"""

from collections.abc import Callable, Iterable
from typing import Literal

from numpy.random import Generator, SeedSequence, default_rng

Split = Literal["validation", "test"]
VALIDATION: Split = "validation"
TEST: Split = "test"
SPLITS: tuple[Split, ...] = (VALIDATION, TEST)
_SPAWN_KEYS: dict[Split, int] = {VALIDATION: 1, TEST: 2}

NoiseGeneratorFactory = Callable[[int, int, int], Generator]
"""Function that returns a generator of exploration noise. Arguments: seed, number of past environment steps, world."""


def parse_split(name: str) -> Split:
    """Returns the split with this name.

    Raises:
        ValueError: for an unknown name; the message lists the allowed names.
    """
    for split in SPLITS:
        if split == name:
            return split
    raise ValueError(f"unknown split {name!r}; allowed: {', '.join(SPLITS)}")


# Evaluation


def make_evaluation_rngs(split: Split, seed: int, numbers: Iterable[int]) -> list[Generator]:
    """Returns one random generator for each episode number of a split. The generator determines the person, the initial
    state and the exploration noise of the episode.
    """
    key = (_SPAWN_KEYS[split],)
    return [default_rng(SeedSequence([seed, number], spawn_key=key)) for number in numbers]


# Training


def make_training_episode_rng(seed: int) -> Generator:
    """Returns the random generator for the person and initial state of a training episode. ``seed`` is sampled by
    ``make_episode_seed_rng`` or ``make_failed_episode_rng``.
    """
    return default_rng(seed)


def make_episode_seed_rng(seed: int, update: int) -> Generator:
    """Returns the random generator for the seeds of the episodes in one update of a recurrent policy."""
    return default_rng([seed, 1, update])


def make_imitation_rng(seed: int, update: int) -> Generator:
    """Returns the random generator for one imitation update: for the worlds that the expert controls, and for the
    minibatches.
    """
    return default_rng([seed, 2, update])


def make_failed_episode_rng(seed: int, steps: int) -> Generator:
    """Returns the random generator for the seeds of the episodes in one update of a feed-forward policy."""
    return default_rng([seed, 3, steps])


def make_robot_noise_rng(seed: int, steps: int, world: int) -> Generator:
    """Returns the random generator for the exploration noise of the robot's actions in one update."""
    return default_rng([seed, 4, steps, world])


def make_human_noise_rng(seed: int, steps: int, world: int) -> Generator:
    """Returns the random generator for the exploration noise of a trained human's actions in one update."""
    return default_rng([seed, 5, steps, world])


def derive_device_minibatch_seed(seed: int, steps: int) -> int:
    """Returns the seed of PyTorch for the minibatches of one update on a device."""
    return int(default_rng([seed, 6, steps]).integers(2**63))


def make_demonstration_rng(seed: int, attempt: int) -> Generator:
    """Returns the random generator for an attempt of a simulated operator: person, initial state and noise."""
    return default_rng([seed, 7, attempt])


def make_cloning_minibatch_rng(seed: int) -> Generator:
    """Returns the random generator for the minibatches of behaviour cloning."""
    return default_rng(seed)


# Single episodes, environments and people; Gymnasium's environments have their own ``np_random``


def make_episode_rng(seed: int) -> Generator:
    """Returns the random generator for the initial state and exploration noise of a single episode: in a study's trial,
    in ``view`` and ``export``, and in the check of a task.
    """
    return default_rng(seed)


def make_trained_human_noise_rng(uniform: float) -> Generator:
    """Returns the random generator for the exploration noise of a trained human in one episode. ``uniform`` is a random
    number of the initial state, 0 to 1.
    """
    return default_rng([5, int(uniform * 2**53)])


def make_benchmark_action_rng(seed: int) -> Generator:
    """Returns the random generator for the random actions of ``bench sim``."""
    return default_rng(seed)


def make_benchmark_episode_rng(seed: int, world: int) -> Generator:
    """Returns the random generator for the person and initial state of a world in ``bench sim``."""
    return default_rng([seed, world])


def make_untrained_weight_rng() -> Generator:
    """Returns the random generator for the weights of the untrained network of ``bench vr``."""
    return default_rng(0)


def make_planner_start_rng() -> Generator:
    """Returns the random generator for the start poses of the inverse kinematics in the experts' motion planner."""
    return default_rng(0)


def make_surface_point_rng() -> Generator:
    """Returns the random generator for the points on the surfaces of bodies in a Foxglove replay."""
    return default_rng(0)


# Studies; ``seed`` is the design's seed. Participant numbers are smaller than the constants of the other streams


def make_condition_order_rng(seed: int) -> Generator:
    """Returns the random generator for the trial orders of a study: orders of tasks and conditions."""
    return default_rng(seed)


def make_trial_seed_rng(seed: int, participant: int, site: str | None) -> Generator:
    """Returns the random generator for the seeds of all trials of a participant."""
    return default_rng([seed, participant, *(site or "").encode()])


def make_practice_robot_rng(seed: int, group: int) -> Generator:
    """Returns the random generator for the practice robots of a group of participants."""
    return default_rng([seed, 2**32 - 1, group])


def make_site_order_rng(seed: int, site: str) -> Generator:
    """Returns the random generator for the order in which a study site assigns trial orders to participants."""
    return default_rng([seed, 2**32 - 2, *site.encode()])


def make_policy_code_rng(seed: int, policies: int) -> Generator:
    """Returns the random generator for the code letters of the policies for a blinded experimenter."""
    return default_rng([seed, policies])


def make_item_order_rng(seed: int) -> Generator:
    """Returns the random generator for the order of a questionnaire's items after a trial; ``seed`` is the trial's
    seed.
    """
    return default_rng(seed)


# Simulated participants


def make_simulated_answer_rng(seed: int, participant: int) -> Generator:
    """Returns the random generator for the age, sex and answers of a participant in ``study simulate``."""
    return default_rng([seed, participant])


def make_participant_trait_rng(seed: int) -> Generator:
    """Returns the random generator for the body, behaviour and leniency of a simulated participant."""
    return default_rng(seed)


def make_participant_motion_rng(seed: int) -> Generator:
    """Returns the random generator for the room, motion and reactions of a simulated participant."""
    return default_rng([seed, 1])


def make_participant_behaviour_rng(seed: int) -> Generator:
    """Returns the random generator for the parameters of a simulated participant's behaviour model."""
    return default_rng([seed, 2])


def make_participant_command_rng(seed: int, part: int) -> Generator:
    """Returns the random generator for the commands of a simulated participant to the robot. ``part``: 0 for the
    participant's traits, 1 for the commands in a trial.
    """
    return default_rng([seed, 4, part])


def make_demonstration_session_rng(seed: int, sample: int) -> Generator:
    """Returns the random generator for the person and the initial state of an episode of ``avrgym demonstrate``."""
    return default_rng([seed, 8, sample])


def make_demonstrator_rng(seed: int) -> Generator:
    """Returns the random generator for the room, tremor and speed noise of a simulated demonstrator."""
    return default_rng([seed, 9])


def make_participant_noise_rng(seed: int) -> Generator:
    """Returns the random generator for the exploration noise of a simulated participant that is a trained human."""
    return default_rng([seed, 3])


# Statistics


def make_simulated_study_rng(seed: int, study: int, part: int) -> Generator:
    """Returns the random generator for a simulated study of ``study power``. ``part``: 0 for answers, 1 for tasks, 2
    for withdrawals, 3 for objective results.
    """
    return default_rng([seed, study, part])


def make_permutation_rng(seed: int) -> Generator:
    """Returns the random generator for the permutations of the energy test."""
    return default_rng(seed)


def make_sign_flip_rng() -> Generator:
    """Returns the random generator for the sign flips of paired permutation tests with many participants."""
    return default_rng(0)


def make_arm_pose_rng() -> Generator:
    """Returns the random generator for the random poses of an arm, for the search of links that can collide."""
    return default_rng(0)


def make_fitted_population_rng() -> Generator:
    """Returns the random generator for the behaviour parameters of a fitted population."""
    return default_rng(0)


TRAINING_POPULATION_SEED = 2020
"""Seed of the sampled training populations, and of the permutations in their comparison with participants."""


def make_training_population_rng(population: int, task: int) -> Generator:
    """Returns the random generator for the people sampled from a training population, for comparison with
    participants.
    """
    return default_rng([TRAINING_POPULATION_SEED, population, task])
