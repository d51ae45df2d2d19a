"""What a task is: plain functions of the state, the same for training, live VR and replay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models.human import JOINTS, RIGHT_ARM, SEATED_RAD, People
from avrgym.models.robot import Robot, UnsuitableError
from avrgym.models.scene import SceneConfig
from avrgym.people import distributions
from avrgym.people.behaviour import Offered
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import RightArm, Start, State

Array = NDArray[np.float64]
TaskState = Any
"""What a task keeps of an episode from step to step: a dataclass of arrays, world axis first."""


@dataclass(frozen=True)
class StepResult:
    """What one control step gave. ``terms``: unweighted, (N,); ``gone`` (N, K): particles to take away.

    ``force_on_person_n`` (N,): of robot and tool together.
    """

    task_state: TaskState
    terms: Mapping[str, Array]
    distance_m: Array
    force_on_person_n: Array
    success: NDArray[np.bool_]
    gone: NDArray[np.bool_]


def when_strong(force_n: Array) -> Array:
    """Forces (N,) of at least ``STRONG_FORCE_N``, and nothing for gentler ones."""
    return np.where(force_n >= STRONG_FORCE_N, force_n, 0.0)


@dataclass(frozen=True)
class Entry:
    """A named part of an observation: how many numbers it has, and the bound ± that none of them leaves.

    Where it is ``per_joint``, the arm has so many numbers for each of its joints.
    """

    name: str
    size: int
    bound: float
    per_joint: bool = False

    def count(self, joints: int) -> int:
        """How many numbers it has for an arm of so many joints."""
        return self.size * joints if self.per_joint else self.size


HEAD_TURNED = Pose(
    rest_rad=SEATED_RAD,
    spread_rad=np.array([np.radians(30.0) if joint.body == "head" else 0.0 for joint in JOINTS.values()]),
)
"""Seated, the head turned up to 30° about each axis (paper, section IV)."""

LIMBS = RIGHT_ARM[:2]
"""What is scratched and washed: upper arm and forearm."""
STRONG_FORCE_N = 10.0
"""What is too much where the tool should touch (paper, section V; reference)."""
ARM_SPREAD_RAD = np.where(distributions.RIGHT_ARM, np.radians(10.0), 0.0)
"""How far off its rest pose each joint of a right arm is found at most, (20,) (paper, section V)."""

REACH_M = 3.0
"""No arm reaches 1.5 m, and a person's head is less than 1.5 m from the robot's base."""
TURN_RAD = 7.0
"""Joint ranges end at ±2π; a soft stop lets a joint go a little beyond."""
UNIT = 1.001
"""A component of a unit quaternion, with room for rounding."""
FORCE_N = 10_000.0
"""Fifty times what the strongest joint can press with at 0.4 m."""


def position(name: str) -> Entry:
    """Three coordinates in metres, relative to something within reach."""
    return Entry(name, 3, REACH_M)


def quaternion(name: str) -> Entry:
    """A rotation w, x, y, z."""
    return Entry(name, 4, UNIT)


def arm_angles(name: str) -> Entry:
    """The angles of the arm's joints in radians."""
    return Entry(name, 1, TURN_RAD, per_joint=True)


def force(name: str) -> Entry:
    """The length of a force in newtons."""
    return Entry(name, 1, FORCE_N)


@dataclass(frozen=True)
class Marks:
    """Spots that a task draws on the person's arm; ``places(arm, task_state)`` (N, ``count``, 3), world frame, metres.

    A spot that is not to be seen lies below the floor.
    """

    count: int
    radius_m: float
    rgb: tuple[float, float, float]
    places: Callable[[RightArm, TaskState], Array]


DRAWN_ABOVE_M = 0.008


def above_clothes(places: Array) -> Array:
    """Places (..., 3) on a limb's collision shape, in the limb's frame, moved outside of skin and sleeve."""
    outwards = places * [1.0, 1.0, 0.0]
    return places + DRAWN_ABOVE_M * transforms.normalize(outwards)


@dataclass(frozen=True)
class Task:
    """A task. Every function takes and gives arrays with the world axis first.

    ``goal`` tells a participant in one sentence what the task is, and not how it is done (paper, section V).
    ``offered`` is what cooperating people bring to the tool, ``pose`` is how people sit or lie.
    ``scene(robot)`` says what stands in the scene. ``start(scene, people, uniforms)`` draws where things begin
    from uniform numbers (n, ``uniforms``). ``remember(people, uniforms)``, with the same numbers, is the task_state
    an episode begins with. ``observe(state, task_state)`` gives (N, O), the numbers that ``observed`` names in that
    order. ``judge(state, action, task_state)`` judges a control step. ``weights`` has one weight for each term; the
    reward is their weighted sum. ``marks`` are drawn on the person.
    """

    name: str
    goal: str
    offered: Offered
    pose: Pose
    uniforms: int
    observed: tuple[Entry, ...]
    weights: Mapping[str, float]
    scene: Callable[[Robot], SceneConfig]
    start: Callable[[SceneConfig, People, Array], Start]
    init_state: Callable[[People, Array], TaskState]
    observe: Callable[[State, TaskState], Array]
    evaluate_step: Callable[[State, Array, TaskState], StepResult]
    marks: Marks | None = None

    def suits(self, robot: Robot) -> bool:
        """Whether a robot has the arm, the mount and the grip that the task asks for."""
        try:
            self.scene(robot)
        except UnsuitableError:
            return False
        return True

    def observation_size(self, joints: int) -> int:
        """How many numbers an observation has with an arm of so many joints."""
        return sum(entry.count(joints) for entry in self.observed)

    def observation_bound(self, joints: int) -> Array:
        """What no number of an observation exceeds either way, (O,)."""
        return np.concatenate([np.full(entry.count(joints), entry.bound) for entry in self.observed])

    def reward(self, terms: Mapping[str, Array]) -> Array:
        """The weighted sum of the terms, (N,)."""
        total = np.zeros_like(next(iter(terms.values())), dtype=float)
        for name, weight in self.weights.items():
            total = total + weight * terms[name]
        return total


def merge(old: TaskState, new: TaskState, ids: NDArray[np.intp]) -> TaskState:
    """The task_state ``old`` of N worlds with the worlds ``ids`` replaced by ``new``."""
    arrays = {}
    for name, array in vars(old).items():
        array = array.copy()
        array[ids] = getattr(new, name)
        arrays[name] = array
    return type(old)(**arrays)
