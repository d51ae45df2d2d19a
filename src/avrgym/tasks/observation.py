"""Observations of robot policies: named entries in a fixed order."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.arrays import get_namespace
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import State
from avrgym.tasks.placement import make_arm_chain

EntryFunction = Callable[[State, Any], FloatArray]
"""Function that computes the values of an entry (N, k), or (N,) for one value. Arguments: state and task state."""

MAX_DISTANCE_M = 3.0
"""Bound of a distance. Arms reach less than 1.5 m, and the head is less than 1.5 m from the robot's base."""
MAX_ANGLE_RAD = 7.0
"""Bound of a joint position. Joint ranges end at ±2π; soft limits allow slightly more.

Slides and bases move by less than 7 m.
"""
MAX_QUATERNION_COMPONENT = 1.001
"""Bound of a component of a unit quaternion, with a margin for rounding."""
MAX_FORCE_N = 10_000.0
"""Bound of a force: 50 times the force of the strongest joint at 0.4 m."""


@dataclass(frozen=True)
class ObservationEntry:
    """An entry of an observation: name, number of values, bound (±), and the function that computes the values.

    Training normalises by ``scale`` (in the entry's unit). Without a scale, it normalises by the observed variance.
    """

    name: str
    size: int
    bound: float
    compute: EntryFunction
    scale: float | None = None


def make_position_entry(name: str, compute: EntryFunction) -> ObservationEntry:
    """Returns an entry of three coordinates in metres, relative to a point within reach."""
    return ObservationEntry(name, 3, MAX_DISTANCE_M, compute)


def make_goal_offset_entry(name: str, compute: EntryFunction) -> ObservationEntry:
    """Returns an entry of the tool's offset from its goal in metres.

    Its scale is fixed: the variance over whole episodes is too large to resolve centimetres near the goal.
    """
    return ObservationEntry(name, 3, MAX_DISTANCE_M, compute, scale=0.05)


def make_quaternion_entry(name: str, compute: EntryFunction) -> ObservationEntry:
    """Returns an entry of a rotation: a unit quaternion w, x, y, z."""
    return ObservationEntry(name, 4, MAX_QUATERNION_COMPONENT, compute)


def make_joint_positions_entry(name: str, count: int, compute: EntryFunction) -> ObservationEntry:
    """Returns an entry of joint positions in radians or metres."""
    return ObservationEntry(name, count, MAX_ANGLE_RAD, compute)


def make_force_entry(name: str, compute: EntryFunction) -> ObservationEntry:
    """Returns an entry of the magnitude of a force in newtons."""
    return ObservationEntry(name, 1, MAX_FORCE_N, compute)


@dataclass(frozen=True)
class ObservationSpec:
    """An observation: its entries, in order.

    Raises:
        ValueError: without entries, or if two entries have the same name.
    """

    entries: tuple[ObservationEntry, ...]

    def __post_init__(self) -> None:
        names = [entry.name for entry in self.entries]
        if not names or len(set(names)) < len(names):
            raise ValueError(
                f"the observation has the entries {', '.join(names) or 'none'}; "
                "allowed: one or more entries with different names"
            )

    @property
    def size(self) -> int:
        """Number O of values in an observation."""
        return sum(entry.size for entry in self.entries)

    @property
    def bound(self) -> FloatArray:
        """Upper bounds (O,) of the absolute values of an observation."""
        return self._each([entry.bound for entry in self.entries])

    @property
    def scale(self) -> FloatArray:
        """Fixed scales (O,) for the normalisation of observations; NaN for values without a fixed scale."""
        return self._each([np.nan if entry.scale is None else entry.scale for entry in self.entries])

    @property
    def entry_end_indices(self) -> IntArray:
        """Index after the last value of each entry, as an array with one index per entry."""
        return np.cumsum([entry.size for entry in self.entries])

    def _each(self, values: list[float]) -> FloatArray:
        return np.repeat(values, [entry.size for entry in self.entries])

    def compute(self, state: State, task_state: Any) -> FloatArray:
        """Returns the observations (N, O) of a state.

        Raises:
            ValueError: if an entry's number of values is not its ``size``.
        """
        count = len(state.tool_pos_w)
        parts = [entry.compute(state, task_state).reshape(count, -1) for entry in self.entries]
        for entry, part in zip(self.entries, parts, strict=True):
            if part.shape[1] != entry.size:
                raise ValueError(
                    f"entry {entry.name} of the observation computed {part.shape[1]} values; allowed: "
                    f"{entry.size}, its size"
                )
        return get_namespace(*parts).concat(parts, axis=-1)


def list_value_names(observation: ObservationSpec) -> list[str]:
    """Returns a name for each value of an observation, such as ``tool_from_torso_m_x``."""
    ends = {1: ("",), 3: ("_x", "_y", "_z"), 4: ("_w", "_x", "_y", "_z")}
    return [
        f"{entry.name}{end}"
        for entry in observation.entries
        for end in ends.get(entry.size) or [f"_{number + 1}" for number in range(entry.size)]
    ]


MEASURED_ENTRIES = (
    "tool_from_torso_m", "tool_rotation", "arm_angles_rad", "joint_positions", "tool_force_n",
)  # fmt: skip
"""Names of the entries that a robot measures itself: joint positions, the tool's pose and the force at the tool."""


def make_robot_measured_mask(observation: ObservationSpec) -> BoolArray:
    """Returns a mask (O,) of the values that the robot measures itself. The others need cameras or other sensors."""
    measured = [entry.name in MEASURED_ENTRIES for entry in observation.entries]
    return np.repeat(measured, [entry.size for entry in observation.entries])


def make_arm_joint_positions_entry(scene: SceneConfig) -> ObservationEntry:
    """Returns an entry of the arm's joint positions.

    For a driving base, x, y and yaw relative to its start follow. The name is ``arm_angles_rad`` for arms of hinges on
    a fixed base.
    """
    count, drives = len(scene.arm.joints), scene.robot.drive is not None
    if drives:
        return make_joint_positions_entry("joint_positions", count + 3, _joint_positions_and_base)
    name = "joint_positions" if make_arm_chain(scene).slide_joints else "arm_angles_rad"
    return make_joint_positions_entry(name, count, lambda state, _: state.joint_positions)


def _joint_positions_and_base(state: State, _: Any) -> FloatArray:
    parts = [state.joint_positions, state.base_displacement]
    return get_namespace(*parts).concat(parts, axis=-1)


def _right_arm(joint: int) -> EntryFunction:
    return lambda state, _: state.right_arm_pos_w[:, joint] - state.robot_torso_pos_w


TOOL_FROM_ROBOT = make_position_entry(
    "tool_from_torso_m", lambda state, _: state.tool_pos_w - state.robot_torso_pos_w
)
TOOL_ROTATION = make_quaternion_entry("tool_rotation", lambda state, _: state.tool_quat_w)
TOOL_FROM_MOUTH = make_goal_offset_entry(
    "tool_from_mouth_m", lambda state, _: state.tool_pos_w - state.mouth_pos_w
)
TOOL_FORCE = make_force_entry("tool_force_n", lambda state, _: state.tool_force_n)
HEAD_FROM_ROBOT = make_position_entry(
    "head_from_torso_m", lambda state, _: state.head_pos_w - state.robot_torso_pos_w
)
HEAD_ROTATION = make_quaternion_entry("head_rotation", lambda state, _: state.head_quat_w)
RIGHT_ARM_FROM_ROBOT = tuple(
    make_position_entry(f"{name}_from_torso_m", _right_arm(joint))
    for joint, name in enumerate(("shoulder", "elbow", "wrist"))
)
"""Common entries. Positions ``…_FROM_ROBOT`` are relative to the robot's torso, with the axes of the world frame."""


def make_mouth_task_observation_spec(scene: SceneConfig) -> ObservationSpec:
    """Returns the observation of the tasks feeding and drinking: tool, robot arm and head."""
    return ObservationSpec(
        (
            TOOL_FROM_ROBOT,
            TOOL_ROTATION,
            TOOL_FROM_MOUTH,
            make_arm_joint_positions_entry(scene),
            HEAD_FROM_ROBOT,
            HEAD_ROTATION,
            TOOL_FORCE,
        )
    )
