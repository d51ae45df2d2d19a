"""Checks whether initial states without collision are found for a robot."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import transforms
from avrgym.models import robot as models
from avrgym.models.human import SEXES, TORSO_HEIGHT_RANGE_M, Person, Sex
from avrgym.models.robot import Robot
from avrgym.people import distributions
from avrgym.simulation.start_clearance import InitialClearanceChecker, NoClearanceError
from avrgym.simulation.worlds import Simulation
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings

MAX_MEAN_SAMPLES = 2.0
"""Maximum mean number of samples for one valid initial state. At this limit, half of the samples are rejected."""
CHECK_POPULATION, NUM_CHECK_STARTS = "revised", 32
"""Population and number of initial states in the check of a robot."""
NUM_STARTS_PER_BODY = 4
"""Number of initial states for each combination of sex and torso height."""
ARM_BATCH_SIZE = 50


@dataclass(frozen=True)
class InitialStateSampleStatistics:
    """Mean and maximum number of samples for one initial state without collision.

    ``reset_error`` is an error message, empty without an error.
    """

    mean_samples: float
    max_samples: int
    reset_error: str = ""

    @property
    def error_message(self) -> str:
        """Error message about the number of samples or a failed reset; empty if there is no error."""
        return self.reset_error or describe_excess_samples(self.mean_samples, self.max_samples)


def describe_excess_samples(mean: float, maximum: int) -> str:
    """Returns an error message if too many initial states were sampled, otherwise an empty string."""
    if mean <= MAX_MEAN_SAMPLES:
        return ""
    return (
        f"an initial state is sampled {mean:.1f} times on average and {maximum} times at most until it has no "
        f"collision; allowed: {MAX_MEAN_SAMPLES:g} on average; move the tool's start pose or the robot's mount, "
        "or choose another seed pose"
    )


def count_initial_state_samples(episodes: Episodes) -> InitialStateSampleStatistics:
    """Reset each world, with its index as seed. Returns statistics of the numbers of sampled initial states."""
    worlds = np.arange(episodes.simulation.num_worlds)
    try:
        episodes.reset(worlds, [random_streams.make_episode_rng(world) for world in worlds.tolist()])
    except NoClearanceError as error:
        return InitialStateSampleStatistics(
            float(episodes.num_initial_state_samples.mean()),
            int(episodes.num_initial_state_samples.max()),
            str(error),
        )
    return InitialStateSampleStatistics(
        float(episodes.num_initial_state_samples.mean()), int(episodes.num_initial_state_samples.max())
    )


@cache
def count_samples_by_body(
    environment_id: str, settings: Settings = DEFAULT_SETTINGS
) -> tuple[tuple[Person, InitialStateSampleStatistics], ...]:
    """Sample initial states next to people at rest: both sexes, with the smallest and the largest torso height.

    Returns each person with the statistics of the numbers of samples.
    """
    episodes = Episodes(
        environment_id, NUM_STARTS_PER_BODY, person=Person(), moving=True, num_threads=1, settings=settings
    )
    return tuple(_of_bodies(episodes))


def _of_bodies(episodes: Episodes) -> Iterator[tuple[Person, InitialStateSampleStatistics]]:
    for sex, height_m in product(SEXES, TORSO_HEIGHT_RANGE_M):
        person = Person(sex, height_m, episodes.task.pose_distribution.rest_angles_rad)
        episodes.set_person(person)
        yield person, count_initial_state_samples(episodes)


def check_initial_states(environment_id: str) -> InitialStateSampleStatistics:
    """Sample initial states next to random people, then next to the people of ``count_samples_by_body``.

    Returns:
        Statistics of the numbers of samples next to random people.

    Raises:
        ValueError: if the mean exceeds ``MAX_MEAN_SAMPLES``, or if no valid initial state is found for a person.
    """
    drawn = count_initial_state_samples(
        Episodes(environment_id, NUM_CHECK_STARTS, people=CHECK_POPULATION, num_threads=1)
    )
    faults = [
        each.error_message
        for each in (drawn, *(own for _, own in count_samples_by_body(environment_id)))
        if each.error_message
    ]
    if faults:
        raise ValueError(f"{environment_id}: {faults[0]}")
    return drawn


def check_placement(robot: str) -> dict[str, InitialStateSampleStatistics]:
    """Run ``check_initial_states`` for each environment of a robot. Returns the results by environment.

    Raises:
        ValueError: if an environment fails, or if the robot has no environments.
    """
    own = [environment for environment, (_, name) in ENVIRONMENTS.items() if name == robot]
    if not own:
        raise ValueError(
            f"robot {robot} has no environments; `avrgym envs` lists the environments and skipped packages"
        )
    return {environment: check_initial_states(environment) for environment in own}


def is_collision_free(task: str, robot: Robot, joint_positions: FloatArray) -> BoolArray:
    """Returns a boolean mask (n,): arm poses (n, J) without contact with person and furniture.

    The base is at its mount. The person has mean height and the rest pose of the task. Both sexes are checked.
    """
    if not len(joint_positions):
        return np.zeros(0, bool)
    parts = np.array_split(np.asarray(joint_positions, float), -(-len(joint_positions) // ARM_BATCH_SIZE))
    clear = [np.all([_clear(task, robot, part, sex) for sex in SEXES], axis=0) for part in parts]
    return np.concatenate(clear)


def _clear(task: str, robot: Robot, joint_positions: FloatArray, sex: Sex) -> BoolArray:
    count, record = len(joint_positions), TASKS[task]
    scene = record.make_scene(robot)
    person = Person(sex, joint_angles_rad=record.pose_distribution.rest_angles_rad)
    start = record.sample_initial_states(
        scene, distributions.repeat_person(person, 1), np.full((1, record.num_random_numbers), 0.5)
    )
    mount = scene.mount
    simulation = Simulation(scene, count, moving=False, num_threads=1)
    placed = {name: np.tile(pos, (count, 1)) for name, pos in start.furniture_pos_w.items()}
    simulation.reset(
        np.arange(count),
        replace(
            start,
            people=distributions.repeat_person(person, count),
            robot_base_pos_w=np.tile(mount.pos_w, (count, 1)),
            robot_base_quat_w=np.tile(
                transforms.from_axis_angle(placement.Z_AXIS, np.asarray(mount.yaw_rad)), (count, 1)
            ),
            joint_positions=joint_positions,
            furniture_pos_w=placed,
        ),
    )
    base = None if mount.is_on_floor else models.ROBOT_NAME_PREFIX + robot.base
    clearance = InitialClearanceChecker(simulation.model, base=base, arms=False, offered=False)
    return np.array(
        [each is None for each in clearance.find_conflicts(simulation.get_geoms(np.arange(count)))], bool
    )
