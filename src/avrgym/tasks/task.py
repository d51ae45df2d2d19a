"""``Task``: the functions and data that define a task. Training, live VR and replay share them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Annotated, Any, NamedTuple, Protocol, get_args

import msgspec
import numpy as np
from msgspec import Meta

from avrgym.array_types import BoolArray, FloatArray, IntArray, NumpyArray
from avrgym.geometry.arrays import get_namespace, to_device_of
from avrgym.models.body_names import TRACKED_BODY_PARTS, Side, TrackedBodyPart
from avrgym.models.human import JOINTS, People
from avrgym.models.robot import Mount, Robot
from avrgym.models.scene import SceneConfig
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.worlds import ArmPoses, InitialState, Simulation, State
from avrgym.tasks.observation import ObservationSpec
from avrgym.tasks.settings import TASK_SETTINGS, Settings

TaskState = Any
"""State of a task in N worlds during an episode: a dataclass of arrays. The first axis is the world."""


class EpisodeStart(msgspec.Struct, frozen=True):
    """The initial state of an episode as plain numbers, without the person. Recordings store it."""

    robot_pos_w: Annotated[list[float], Meta(description="Position of the robot's base, m.")]
    robot_q_w: Annotated[list[float], Meta(description="Orientation of the robot's base: w, x, y, z.")]
    joint_positions: Annotated[
        list[float], Meta(description="Joint positions of the robot's arm, rad or m.")
    ] = msgspec.field(name="arm_angles_rad")
    placed_pos_w: Annotated[
        dict[str, list[float]], Meta(description="Positions of movable furniture by its name, m.")
    ]
    memory: Annotated[dict[str, Any], Meta(description="Arrays of the task state, by name.")]


@dataclass(frozen=True)
class StepResult:
    """Result of one control step in N worlds.

    Attributes:
        task_state: the new state of the task.
        reward_terms: unweighted reward terms by name, (N,) each. The names are those of ``Task.reward_weights``.
        distance_m: distance of the tool from its goal (N,).
        force_on_person_n: contact force of robot and tool on the person (N,).
        success: whether the task has succeeded up to this step (N,).
        num_events: number of events, such as bites, in this step (N,). Each event plays a sound in VR.
        removed_particles_mask: mask (N, K) of particles to remove; K is 0 for tools without particles.
    """

    task_state: TaskState
    reward_terms: Mapping[str, FloatArray]
    distance_m: FloatArray
    force_on_person_n: FloatArray
    success: BoolArray
    num_events: IntArray
    removed_particles_mask: BoolArray


class RunningEpisodes(Protocol):
    """Interface of ``Episodes`` for experts: simulation, scene and states."""

    @property
    def simulation(self) -> Simulation:
        """The physics of N worlds."""
        ...

    @property
    def scene(self) -> SceneConfig:
        """The scene of all worlds."""
        ...

    @property
    def task_state(self) -> TaskState:
        """The current state of the task in all worlds."""
        ...

    def get_state(self) -> State:
        """Returns the current physical state of all worlds."""
        ...


Controller = Callable[[FloatArray], FloatArray]
"""A function that maps observations (N, O) to actions (N, A)."""
Expert = Callable[[RunningEpisodes], Controller]
"""A function that creates a controller after a reset, for one episode."""


class CameraView(NamedTuple):
    """Pose of a camera that views the scene.

    ``target_pos_w`` (3,) is the point in the centre of the image, world frame. ``distance_m`` is the distance of the
    camera from this point. The angles are those of MuJoCo's free camera.
    """

    target_pos_w: tuple[float, float, float]
    distance_m: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def camera_pos_w(self) -> FloatArray:
        """Position (3,) of the camera in the world frame."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        across = np.cos(elevation)
        forward = np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.sin(elevation)])
        return np.array(self.target_pos_w) - self.distance_m * forward


WHEELCHAIR_SIDE_CAMERA_VIEW = CameraView((-0.35, -0.20, 0.92), 2.5, 120.0, -24.0)
"""View of a robot on the floor that brings a tool to the mouth of a person in a wheelchair."""


class CameraViews(NamedTuple):
    """Camera views for a mounted robot and for a robot on the floor, without occlusion by arm or person."""

    mounted_robot_view: CameraView
    floor_robot_view: CameraView

    def select_view(self, mount: Mount) -> CameraView:
        """Returns the view for a robot with this mount: on furniture or on the floor."""
        return self.floor_robot_view if mount.is_on_floor else self.mounted_robot_view


@dataclass(frozen=True)
class Markers:
    """Markers that a task draws on the person's arm, such as an itch.

    ``num_markers`` is their number in each world. ``places(arms, task_state)`` returns their positions (N,
    ``num_markers``, 3) in the world frame, in metres. The positions of hidden markers are below the floor.
    """

    num_markers: int
    radius_m: float
    rgb: tuple[float, float, float]
    compute_positions_w: Callable[[ArmPoses, TaskState], FloatArray]


@dataclass(frozen=True, kw_only=True)
class Task:
    """Definition of a task. Its functions accept and return arrays of any array library. The first axis is the world.

    Attributes:
        name: an ASCII identifier; environment ids are ``avrgym/{name}{robot}-v1``.
        goal_description: the task in one sentence for participants. It does not describe the motion of the robot
            (paper, section V).
        pose_distribution: initial pose of the person.
        offered_body_part: body part that cooperating people move towards the tool.
        strength_share: share of their strength with which people hold their pose. With a small share, the robot can
            move their joints. A mapping contains a share for each joint by name; joints that are not listed have full
            strength. With ``None``, static people are rigid.
        make_scene: function that returns the scene for a robot; called once for each robot.
        num_random_numbers: number of uniform random numbers that ``sample_initial_states`` needs for each world.
        sample_initial_states: returns initial states, from the scene, the people and uniform random numbers (n,
            ``num_random_numbers``).
        make_initial_task_state: returns the initial task state, from the people and the same random numbers.
        make_observation_spec: returns the observation for a scene.
        reward_weights: weight of each reward term; the reward is the weighted sum.
        evaluate_step: returns reward terms and success. Arguments: the state after the step, the action (N, A), and the
            previous task state.
        expert: expert that plans with the full state. It shows that the task is feasible (``--policy oracle``).
        feedback_expert: expert without memory: its action is a smooth function of the current state. Training imitates
            it.
        camera_views: camera views for rendered images of the scene.
        hyperparameters: training hyperparameters that differ from the defaults of ``learning.hyperparameters``.
        memory_expert: expert with memory. Recurrent policies imitate it instead of ``feedback_expert``.
        compute_detour_m: returns the extra length (N,) of the path of tool and hand, compared with the straight path.
            The hyperparameter ``detour_weight_per_m`` needs it.
        markers: markers that the task draws on the person's arm, such as an itch.
        withdraws_tool_after_success: whether the robot withdraws its tool after success. This also needs the option
            ``withdraw_after_success`` of the episode or session.
        make_variant: function that returns the task with the tool, particles and table of settings. ``None``: the
            task has no such settings.
        tracked_body_parts: body parts that VR must track: the head, and the arms that the robot works on. If the
            tracking of a part is lost, the attempt ends.

    Raises:
        TypeError: if a field is missing or has a wrong type.
        ValueError: if the value of a field is not allowed.
    """

    name: str
    goal_description: str
    pose_distribution: PoseDistribution
    offered_body_part: OfferedBodyPart
    make_scene: Callable[[Robot], SceneConfig]
    num_random_numbers: int
    sample_initial_states: Callable[[SceneConfig, People, FloatArray], InitialState]
    make_initial_task_state: Callable[[People, FloatArray], TaskState]
    make_observation_spec: Callable[[SceneConfig], ObservationSpec]
    reward_weights: Mapping[str, float]
    evaluate_step: Callable[[State, FloatArray, TaskState], StepResult]
    expert: Expert
    feedback_expert: Expert
    camera_views: CameraViews
    strength_share: float | Mapping[str, float] | None = None
    hyperparameters: Mapping[str, Any] = field(default_factory=dict[str, Any])
    memory_expert: Expert | None = None
    compute_detour_m: Callable[[State, TaskState], FloatArray] | None = None
    markers: Markers | None = None
    withdraws_tool_after_success: bool = False
    tracked_body_parts: tuple[TrackedBodyPart, ...] = ("head",)
    make_variant: Callable[[Settings], "Task"] | None = None

    def __post_init__(self) -> None:
        for part, kind in _KINDS.items():
            self._check_part(part, isinstance(getattr(self, part), kind), kind.__name__)
        for part in _FUNCTIONS:
            self._check_part(part, callable(getattr(self, part)), "function")
        if not (self.name.isascii() and self.name.isidentifier()):
            raise ValueError(
                f"the task name is {self.name!r}; allowed: an identifier of ASCII letters and digits"
            )
        if not self.goal_description.strip():
            raise ValueError(
                f"task {self.name}: the field `goal_description` is empty; allowed: one sentence"
            )
        if self.offered_body_part not in OFFERED_BODY_PARTS:
            raise ValueError(
                f"task {self.name}: the field `offered_body_part` is {self.offered_body_part!r}; allowed: "
                f"{', '.join(map(repr, OFFERED_BODY_PARTS))}"
            )
        share = self.strength_share
        if share is not None and not _is_strength_share(share):
            raise ValueError(
                f"task {self.name}: the field `strength_share` is {share!r}; allowed: None, a number above 0 and up "
                f"to 1, or such numbers by joint name ({', '.join(JOINTS)})"
            )
        if "head" not in self.tracked_body_parts or not set(self.tracked_body_parts) <= set(
            TRACKED_BODY_PARTS
        ):
            raise ValueError(
                f"task {self.name}: the field `tracked_body_parts` is {self.tracked_body_parts!r}; allowed: 'head', "
                f"and 'left' "
                f"or 'right' "
                "for the arms that the robot works on"
            )
        if not self.reward_weights:
            raise ValueError(
                f"task {self.name}: the field `reward_weights` is empty; allowed: a weight for each reward term"
            )
        if self.hyperparameters.get("detour_weight_per_m") and self.compute_detour_m is None:
            raise ValueError(
                f"task {self.name} has the hyperparameter detour_weight_per_m, but no function compute_detour_m; add it"
            )
        if self.memory_expert is not None:
            self._check_part("memory_expert", callable(self.memory_expert), "function")
        object.__setattr__(self, "make_scene", cache(self.make_scene))
        if self.make_variant is not None:
            object.__setattr__(self, "make_variant", cache(self.make_variant))

    def _check_part(self, part: str, fits: bool, kind: str) -> None:
        if not fits:
            raise TypeError(
                f"task {self.name}: the field `{part}` is {getattr(self, part)!r}; allowed: a value of type {kind}"
            )

    @property
    def served_arm(self) -> Side | None:
        """The arm of the person that the robot works on, if any."""
        return next((part for part in self.tracked_body_parts if part != "head"), None)

    def apply_settings(self, settings: Settings) -> "Task":
        """Returns the task with the tool, particles and table of settings.

        Raises:
            ValueError: for settings that this task does not have.
        """
        given = [name for name in TASK_SETTINGS if getattr(settings, name) is not None]
        if not given:
            return self
        if self.make_variant is None:
            raise ValueError(f"task {self.name} has no setting {given[0]!r}; remove this setting")
        # Scene settings do not change the task.
        return self.make_variant(Settings(**{name: getattr(settings, name) for name in given}))

    def compute_reward(self, terms: Mapping[str, FloatArray]) -> FloatArray:
        """Returns the weighted sum (N,) of reward terms.

        Raises:
            ValueError: if terms and weights have different names.
        """
        if terms.keys() != self.reward_weights.keys():
            raise ValueError(
                f"task {self.name} returned the reward terms {', '.join(terms)}; allowed: the names of its weights, "
                f"{', '.join(self.reward_weights)}"
            )
        total: Any = 0.0
        for name, weight in self.reward_weights.items():
            total = total + weight * terms[name]
        return total


OFFERED_BODY_PARTS: tuple[OfferedBodyPart, ...] = get_args(OfferedBodyPart)
_KINDS: Mapping[str, type] = {
    "name": str,
    "goal_description": str,
    "pose_distribution": PoseDistribution,
    "num_random_numbers": int,
    "reward_weights": Mapping,
    "camera_views": CameraViews,
    "hyperparameters": Mapping,
    "withdraws_tool_after_success": bool,
}
_FUNCTIONS = (
    "make_scene",
    "sample_initial_states",
    "make_initial_task_state",
    "make_observation_spec",
    "evaluate_step",
    "expert",
    "feedback_expert",
)


def compute_joint_strength_fractions(strength_share: float | Mapping[str, float]) -> FloatArray:
    """Returns the strength share (20,) of each joint of the person, from ``Task.strength_share``."""
    if isinstance(strength_share, Mapping):
        return np.array([strength_share.get(name, 1.0) for name in JOINTS])
    return np.full(len(JOINTS), strength_share)


def _is_strength_share(strength_share: float | Mapping[str, float]) -> bool:
    if isinstance(strength_share, Mapping) and not strength_share.keys() <= JOINTS.keys():
        return False
    shares = compute_joint_strength_fractions(strength_share)
    return bool(((shares > 0.0) & (shares <= 1.0)).all())


def get_task_state_arrays(task_state: object) -> dict[str, NumpyArray]:
    """Returns the arrays of a task state, by name."""
    return vars(task_state)


def replace_task_states(old: TaskState, new: TaskState, ids: IntArray) -> TaskState:
    """Returns a copy of the state ``old`` of N worlds. The worlds ``ids`` (n,) have the state ``new``."""
    arrays = {
        name: get_namespace(array).asarray(array, copy=True)
        for name, array in get_task_state_arrays(old).items()
    }
    for name, array in arrays.items():
        array[ids] = to_device_of(getattr(new, name), array)
    return type(old)(**arrays)
