"""Whether a robot leaves room where episodes begin: how often starts are drawn, and who is refused."""

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
from avrgym.simulation.start_clearance import NoClearanceError, StartClearance
from avrgym.simulation.worlds import Simulation
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS

MAX_MEAN_DRAWS = 2.0
"""How often a start may be drawn on average: then half of all draws are refused."""
PEOPLE, STARTS = "revised", 32
"""The people of a check of a robot, and how many starts it draws."""
BODY_STARTS = 4
"""How many starts are drawn for each body."""
ARMS_AT_ONCE = 50


@dataclass(frozen=True)
class StartDraws:
    """How often starts were drawn until each had room: on average and at most. ``refused``: why one never had."""

    mean: float
    most: int
    refused: str = ""

    @property
    def fault(self) -> str:
        """What is wrong in words, if anything is."""
        return self.refused or excess_draws(self.mean, self.most)


def excess_draws(mean: float, most: int) -> str:
    """That starts are drawn too often, in words; empty where they are not."""
    if mean <= MAX_MEAN_DRAWS:
        return ""
    return (
        f"a start is drawn {mean:.1f} times on average and {most} times at most until it has room; "
        f"allowed: {MAX_MEAN_DRAWS:g} on average: move the robot's mount or choose another seed pose"
    )


def draw_starts(episodes: Episodes) -> StartDraws:
    """Begin an episode in each world, seeded by its number."""
    worlds = np.arange(episodes.simulation.num_worlds)
    try:
        episodes.reset(worlds, [random_streams.episode(world) for world in worlds.tolist()])
    except NoClearanceError as error:
        return StartDraws(float(episodes.start_draws.mean()), int(episodes.start_draws.max()), str(error))
    return StartDraws(float(episodes.start_draws.mean()), int(episodes.start_draws.max()))


@cache
def draws_by_body(environment_id: str) -> tuple[tuple[Person, StartDraws], ...]:
    """Starts beside people who rest as in a session: both bodies, as short and as tall as anybody is measured."""
    episodes = Episodes(environment_id, BODY_STARTS, person=Person(), moving=True, num_threads=1)
    return tuple(_of_bodies(episodes))


def _of_bodies(episodes: Episodes) -> Iterator[tuple[Person, StartDraws]]:
    for sex, height_m in product(SEXES, TORSO_HEIGHT_RANGE_M):
        person = Person(sex, height_m, episodes.task.pose.rest_rad)
        episodes.set_person(person)
        yield person, draw_starts(episodes)


def check_starts(environment_id: str) -> StartDraws:
    """Draw starts beside random people and beside each body.

    Returns:
        How often they were drawn beside random people.

    Raises:
        ValueError: where that is more often than ``MAX_MEAN_DRAWS``, or somebody has no start.
    """
    drawn = draw_starts(Episodes(environment_id, STARTS, people=PEOPLE, num_threads=1))
    faults = [
        each.fault for each in (drawn, *(own for _, own in draws_by_body(environment_id))) if each.fault
    ]
    if faults:
        raise ValueError(f"{environment_id}: {faults[0]}")
    return drawn


def check_placement(robot: str) -> dict[str, StartDraws]:
    """Check the placement of a robot in each of its environments: ``check_starts``, by environment.

    Raises:
        ValueError: naming the first environment that fails.
    """
    own = [environment for environment, (_, name) in ENVIRONMENTS.items() if name == robot]
    return {environment: check_starts(environment) for environment in own}


def is_collision_free(task: str, robot: Robot, angles_rad: FloatArray) -> BoolArray:
    """Which poses (n, J) of a robot's arm keep clear of person and furniture, with its base where its mount puts it.

    The person rests as the task has it, in either body of middle height.
    """
    if not len(angles_rad):
        return np.zeros(0, bool)
    parts = np.array_split(np.asarray(angles_rad, float), -(-len(angles_rad) // ARMS_AT_ONCE))
    clear = [np.all([_clear(task, robot, part, sex) for sex in SEXES], axis=0) for part in parts]
    return np.concatenate(clear)


def _clear(task: str, robot: Robot, angles_rad: FloatArray, sex: Sex) -> BoolArray:
    count, record = len(angles_rad), TASKS[task]
    scene = record.scene(robot)
    person = Person(sex, joint_angles_rad=record.pose.rest_rad)
    start = record.start(scene, distributions.repeat_person(person, 1), np.full((1, record.uniforms), 0.5))
    mount = scene.mount
    simulation = Simulation(scene, count, moving=False, num_threads=1)
    placed = {name: np.tile(pos, (count, 1)) for name, pos in start.placed_pos_w.items()}
    simulation.reset(
        np.arange(count),
        replace(
            start,
            people=distributions.repeat_person(person, count),
            robot_pos_w=np.tile(mount.pos_w, (count, 1)),
            robot_q_w=np.tile(transforms.from_axis_angle(placement.Z, np.asarray(mount.yaw_rad)), (count, 1)),
            arm_angles_rad=angles_rad,
            placed_pos_w=placed,
        ),
    )
    base = None if mount.on_floor else models.PREFIX + robot.base
    clearance = StartClearance(simulation.model, base=base, arms=False, offered=False)
    return np.array([each is None for each in clearance.conflicts(simulation.geoms(np.arange(count)))], bool)
