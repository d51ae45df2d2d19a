"""What a task is: one record of plain functions and data, the same for training, live VR and replay."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, NamedTuple, Protocol, get_args

import msgspec
from msgspec import Meta

from avrgym.array_types import BoolArray, FloatArray, IntArray, NumpyArray
from avrgym.geometry.arrays import moved_to, namespace
from avrgym.models.body_names import PARTS, Part
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.people.cooperation import OfferedPart
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import RightArm, Simulation, Start, State
from avrgym.tasks.observation import Observation

TaskState = Any
"""What a task keeps of an episode from step to step: a dataclass of arrays, world axis first."""


class EpisodeStart(msgspec.Struct, frozen=True):
    """The start of an episode, without its person, in plain numbers: recordings store it."""

    robot_pos_w: Annotated[list[float], Meta(description="Position of the robot's base, m.")]
    robot_q_w: Annotated[list[float], Meta(description="Orientation of the robot's base: w, x, y, z.")]
    arm_angles_rad: Annotated[list[float], Meta(description="Joint angles of the robot's arm.")]
    placed_pos_w: Annotated[
        dict[str, list[float]], Meta(description="Positions of movable furniture by its name, m.")
    ]
    memory: Annotated[dict[str, Any], Meta(description="The state of the task, by field.")]


@dataclass(frozen=True)
class StepResult:
    """What one control step gave in N worlds.

    Attributes:
        task_state: what the task keeps from here on.
        terms: the reward's terms, unweighted, (N,) each; those that ``Task.weights`` names.
        distance_m: from the tool to its goal, (N,).
        force_on_person_n: of robot and tool together, (N,).
        success: whether the robot has succeeded so far, (N,).
        events: how often something happened that a participant hears a chime for, such as a bite, (N,).
        gone: which particles of the tool to take away, (N, K); K is 0 for tools without.
    """

    task_state: TaskState
    terms: Mapping[str, FloatArray]
    distance_m: FloatArray
    force_on_person_n: FloatArray
    success: BoolArray
    events: IntArray
    gone: BoolArray


class RunningEpisodes(Protocol):
    """What an expert may look at: the worlds, what stands in them, and what the task keeps."""

    @property
    def simulation(self) -> Simulation:
        """The physics of N worlds."""
        ...

    @property
    def scene(self) -> SceneConfig:
        """What stands in each of them."""
        ...

    @property
    def task_state(self) -> TaskState:
        """What the task keeps of their episodes."""
        ...

    def state(self) -> State:
        """What there is to see now."""
        ...


Controller = Callable[[FloatArray], FloatArray]
"""From the observations (N, O) of a control step to actions (N, A)."""
Expert = Callable[[RunningEpisodes], Controller]
"""Made when episodes have begun, and good for as long as they last."""


class View(NamedTuple):
    """From where a scene is seen: a point (3,), world frame, and the camera's distance and angles from it."""

    look_at_w: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float
    elevation_deg: float


BESIDE_WHEELCHAIR = View((-0.35, -0.20, 0.92), 2.5, 120.0, -24.0)
"""Of a robot that stands on the floor and brings something to the mouth of who sits in the wheelchair."""


class Views(NamedTuple):
    """The views of a mounted robot and of one that stands on the floor; neither arm nor person hides what it does."""

    mounted: View
    on_floor: View


@dataclass(frozen=True)
class Marks:
    """Spots that a task draws on the person's arm; ``places(arm, task_state)`` (N, ``count``, 3), world frame, metres.

    A spot that is not to be seen lies below the floor.
    """

    count: int
    radius_m: float
    rgb: tuple[float, float, float]
    places: Callable[[RightArm, TaskState], FloatArray]


@dataclass(frozen=True, kw_only=True)
class Task:
    """A task. Every function takes and gives arrays with the world axis first, of NumPy or of another library.

    Attributes:
        name: an ASCII identifier; environments are called ``avrgym/{name}{robot}-v1``.
        goal: tells a participant in one sentence what the task is, and not how it is done (paper, section V).
        pose: how people sit or lie.
        offered: what cooperating people bring to the tool.
        strength_share: with what share of their strength people hold their pose, so that the robot can move their
            joints; without one, those who do nothing by themselves are stiff.
        scene: says what stands in the scene with a robot; asked once for each, so that what is computed from a scene is
            computed once.
        uniforms: how many uniform numbers a start takes.
        start: where things begin, drawn from the scene, the people and uniform numbers (n, ``uniforms``).
        init_state: from the people and the same numbers, the task's state that an episode begins with.
        observation: what a policy sees in a scene.
        weights: the weight of each reward term; the reward is their weighted sum.
        evaluate_step: what the control step gave that ends in a state, from that state, the action (N, A) and the
            task's state before.
        expert: plans with all that can be known: it shows that the task can be done.
        feedback_expert: does without plan or memory what depends evenly on the present: training imitates it.
        views: from where pictures are taken.
        hyperparameters: those of training that differ from the defaults of ``learning.hyperparameters``.
        memory_expert: may remember; policies that remember imitate it in place of the reactive one.
        detour_m: how much longer than straight on the way of tool and hand to the goal is, (N,); with a
            ``detour_weight_per_m`` training draws the policy along it.
        marks: what is drawn on the person.
        withdraws_after_success: whether going on after success helps nobody. The robot then withdraws its tool where an
            episode or a session has ``withdraw_after_success``.
        tracked: the parts of a participant's body that must be tracked in VR, their head and the arms that the robot
            works on. An attempt ends when one of them is not.

    Raises:
        TypeError: for a part that is missing or of another kind, naming it.
        ValueError: for a part with a value that is not allowed, naming it and what is.
    """

    name: str
    goal: str
    pose: Pose
    offered: OfferedPart
    scene: Callable[[Robot], SceneConfig]
    uniforms: int
    start: Callable[[SceneConfig, People, FloatArray], Start]
    init_state: Callable[[People, FloatArray], TaskState]
    observation: Callable[[SceneConfig], Observation]
    weights: Mapping[str, float]
    evaluate_step: Callable[[State, FloatArray, TaskState], StepResult]
    expert: Expert
    feedback_expert: Expert
    views: Views
    strength_share: float | None = None
    hyperparameters: Mapping[str, Any] = field(default_factory=dict[str, Any])
    memory_expert: Expert | None = None
    detour_m: Callable[[State, TaskState], FloatArray] | None = None
    marks: Marks | None = None
    withdraws_after_success: bool = False
    tracked: tuple[Part, ...] = ("head",)

    def __post_init__(self) -> None:
        for part, kind in _KINDS.items():
            self._check_part(part, isinstance(getattr(self, part), kind), kind.__name__)
        for part in _FUNCTIONS:
            self._check_part(part, callable(getattr(self, part)), "function")
        if not (self.name.isascii() and self.name.isidentifier()):
            raise ValueError(
                f"a task's name is {self.name!r}; allowed: an identifier of ASCII letters and digits"
            )
        if not self.goal.strip():
            raise ValueError(f"the goal of task {self.name} is empty; allowed: a sentence")
        if self.offered not in OFFERED:
            raise ValueError(
                f"offered of task {self.name} is {self.offered!r}; allowed: {', '.join(map(repr, OFFERED))}"
            )
        if self.strength_share is not None and not 0.0 < self.strength_share <= 1.0:
            raise ValueError(
                f"strength_share of task {self.name} is {self.strength_share!r}; allowed: above 0 to 1, or None"
            )
        if "head" not in self.tracked or not set(self.tracked) <= set(PARTS):
            raise ValueError(
                f"tracked of task {self.name} is {self.tracked!r}; allowed: 'head', and 'left' or 'right' for the "
                "arms that the robot works on"
            )
        if not self.weights:
            raise ValueError(
                f"the weights of task {self.name} are empty; allowed: a weight for each reward term"
            )
        if self.hyperparameters.get("detour_weight_per_m") and self.detour_m is None:
            raise ValueError(f"task {self.name} has a detour_weight_per_m, but no detour_m")
        if self.memory_expert is not None:
            self._check_part("memory_expert", callable(self.memory_expert), "function")
        object.__setattr__(self, "scene", cache(self.scene))

    def _check_part(self, part: str, fits: bool, kind: str) -> None:
        if not fits:
            raise TypeError(f"{part} of task {self.name} is {getattr(self, part)!r}; allowed: a {kind}")

    def reward(self, terms: Mapping[str, FloatArray]) -> FloatArray:
        """The weighted sum of the terms, (N,).

        Raises:
            ValueError: for other terms than those that have weights, naming them.
        """
        if terms.keys() != self.weights.keys():
            raise ValueError(
                f"task {self.name} gave the reward terms {', '.join(terms)}; it has weights for "
                f"{', '.join(self.weights)}"
            )
        total: Any = 0.0
        for name, weight in self.weights.items():
            total = total + weight * terms[name]
        return total


OFFERED: tuple[OfferedPart, ...] = get_args(OfferedPart)
_KINDS: Mapping[str, type] = {
    "name": str,
    "goal": str,
    "pose": Pose,
    "uniforms": int,
    "weights": Mapping,
    "views": Views,
    "hyperparameters": Mapping,
    "withdraws_after_success": bool,
}
_FUNCTIONS = (
    "scene",
    "start",
    "init_state",
    "observation",
    "evaluate_step",
    "expert",
    "feedback_expert",
)


def state_arrays(task_state: object) -> dict[str, NumpyArray]:
    """What a task's state of N worlds holds, by name."""
    return vars(task_state)


def replace_worlds(old: TaskState, new: TaskState, ids: IntArray) -> TaskState:
    """The arrays ``old`` of N worlds with the worlds ``ids`` replaced by ``new``, of the host or where ``old`` is."""
    arrays = {name: namespace(array).asarray(array, copy=True) for name, array in state_arrays(old).items()}
    for name, array in arrays.items():
        array[ids] = moved_to(getattr(new, name), array)
    return type(old)(**arrays)
