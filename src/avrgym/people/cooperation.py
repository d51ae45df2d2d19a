"""Behaviour model of people who cooperate with the robot, like the study's participants (paper, section V).

They perceive the tool with a reaction delay. In feeding and drinking they turn the face to the tool, and lean towards a
tool that is near. In scratching and bathing they lift the arm towards a tool that is near. They also sway. Reaction
times of 0.2 to 0.4 s and sway below 0.5 Hz are assumptions about adults who do not hurry. ``people.motor_model``
moves the joints.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, copy_as_float, get_namespace, interpolate, make_row_indices
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import motor_model
from avrgym.people.motor_model import MotorState

OfferedBodyPart = Literal["mouth", "arm", "left_arm", "nothing"]
"""Body part that people move towards the tool. ``arm`` is the right arm.

``left_arm`` moves only by the actions of a trained human.
"""


class PersonObservation(Protocol):
    """Observation of N people: the fields of ``simulation.state.State`` that they perceive. World frame, metres."""

    @property
    def tool_pos_w(self) -> FloatArray:
        """Positions (N, 3) of the robots' tools."""
        ...

    @property
    def head_pos_w(self) -> FloatArray:
        """Positions (N, 3) of the people's head centres."""
        ...

    @property
    def mouth_pos_w(self) -> FloatArray:
        """Positions (N, 3) of the people's mouths."""
        ...

    @property
    def right_arm_pos_w(self) -> FloatArray:
        """Positions (N, 3, 3) of shoulder, elbow and wrist of the people's right arms."""
        ...


NUM_RANDOM_NUMBERS = 6
"""Number of uniform random numbers for the behaviour parameters of one person."""

TOOL_HISTORY_LENGTH = 5
"""Number of stored tool positions: one for each of the latest control steps."""
REACTION_DELAY_RANGE_STEPS = (2, 4)
"""Range of the reaction delay, in control steps."""
FACING_SHARE_RANGE = (0.3, 0.7)
"""Range of the executed share of the head rotation that is needed to face the tool."""
SWAY_AMPLITUDE_RANGE_RAD = (float(np.radians(0.3)), float(np.radians(1.0)))
SWAY_FREQUENCY_RANGE_HZ = (0.1, 0.3)
"""Range of the frequency at which people sway, in Hz."""

MOUTH_APPROACH_DISTANCE_M, LEAN_ANGLE_RAD = 0.30, float(np.radians(10.0))
ARM_APPROACH_DISTANCE_M, ARM_LIFT_ANGLE_RAD = 0.40, float(np.radians(8.0))
MAX_HEAD_TURN_RAD = np.radians([30.0, 0.0, 40.0])
SPEED_FACTOR_RANGE = (0.82, 1.18)
"""Range of the factor that multiplies the speed and acceleration limits of ``people.motor_model``. It is the same as
for the zoo's style ``cooperating``.
"""

OFFERED_JOINTS: Mapping[OfferedBodyPart, tuple[str, ...]] = {
    "mouth": tuple(name for name, joint in JOINTS.items() if joint.body in ("torso", "head")),
    "arm": tuple(name for name in JOINTS if name.startswith("right_")),
    "left_arm": tuple(name for name in JOINTS if name.startswith("left_")),
    "nothing": (),
}
"""Names of the joints that move the offered body part towards the tool."""

_WAIST_X = JOINT_INDEX["waist_x"]
_HEAD = np.array([JOINT_INDEX[f"head_{axis}"] for axis in "xyz"])
_LIFT = np.array([JOINT_INDEX["right_shoulder_y"], JOINT_INDEX["right_elbow_x"]])


@dataclass(frozen=True)
class CooperationState:
    """State of the behaviour model for N people.

    Attributes:
        tool_history_w: latest tool positions (N, ``TOOL_HISTORY_LENGTH``, 3), newest first.
        joint_targets_rad: joint targets without rhythmic motion (N, 20).
        initial_angles_rad: initial joint angles (N, 20).
        time_s: time since the start of the episode (N,); used by version 1 of the motion only.
        reaction_delay_steps: reaction delay in control steps (N,).
        facing_share: executed share (N,) of the head rotation that is needed to face the tool.
        sway_amplitude_rad: amplitude of the waist's sway (N,).
        sway_hz: frequency of the sway (N,).
        sway_phase_rad: phases of the forward and the sideways sway (N, 2).
    """

    tool_history_w: FloatArray
    joint_targets_rad: FloatArray
    initial_angles_rad: FloatArray
    time_s: FloatArray
    reaction_delay_steps: IntArray
    facing_share: FloatArray
    sway_amplitude_rad: FloatArray
    sway_hz: FloatArray
    sway_phase_rad: FloatArray


def make_initial_state(people: People, uniforms: FloatArray) -> CooperationState:
    """Returns the initial state of n people. Behaviour parameters are sampled from uniform random numbers (n,
    ``NUM_RANDOM_NUMBERS``).
    """
    xp, count = get_namespace(uniforms), len(uniforms)
    low, high = REACTION_DELAY_RANGE_STEPS
    return CooperationState(
        tool_history_w=xp.full(
            (count, TOOL_HISTORY_LENGTH, 3), xp.inf, dtype=uniforms.dtype, device=uniforms.device
        ),
        joint_targets_rad=people.joint_angles_rad,
        initial_angles_rad=people.joint_angles_rad,
        time_s=xp.zeros_like(uniforms[:, 0]),
        reaction_delay_steps=xp.minimum(low + xp.astype((high - low + 1) * uniforms[:, 0], xp.int64), high),
        facing_share=interpolate(FACING_SHARE_RANGE, uniforms[:, 1]),
        sway_amplitude_rad=interpolate(SWAY_AMPLITUDE_RANGE_RAD, uniforms[:, 2]),
        sway_hz=interpolate(SWAY_FREQUENCY_RANGE_HZ, uniforms[:, 3]),
        sway_phase_rad=2.0 * np.pi * uniforms[:, 4:6],
    )


def choose_goal_angles(
    state: CooperationState,
    goals_rad: FloatArray,
    observation: PersonObservation,
    offered: OfferedBodyPart,
    posture: Posture,
) -> tuple[CooperationState, FloatArray]:
    """Returns the next state and the people's goal joint angles (N, 20) in radians, given an observation of the tool.

    ``goals_rad`` (N, 20) are the previous goals. Goals of joints that do not react to the tool do not change.
    """
    xp = get_namespace(state.joint_targets_rad)
    history = xp.concat([observation.tool_pos_w[:, None], state.tool_history_w[:, :-1]], axis=1)
    tool = history[make_row_indices(history), state.reaction_delay_steps]
    match offered:
        case "mouth":
            goals = _mouth_goals(state, goals_rad, observation, tool, posture)
        case "arm":
            goals = _arm_goals(state, goals_rad, observation, tool)
        case "left_arm" | "nothing":
            goals = goals_rad
    return replace(state, tool_history_w=history), goals


def advance_time(state: CooperationState) -> CooperationState:
    """Returns the state with its time increased by one control step."""
    return replace(state, time_s=state.time_s + CONTROL_STEP_S)


def make_initial_motor_state(
    state: CooperationState, people: People, uniforms: FloatArray, *, sways: bool
) -> MotorState:
    """Returns the initial state of the motor model, from the same random numbers as ``make_initial_state``.

    ``sways``: whether people sway and have physiological tremor.
    """
    none, further = 0.0 * state.time_s, motor_model.derive_random_numbers(uniforms)
    rhythms = motor_model.sample_rhythms(
        state.sway_amplitude_rad, state.sway_hz, state.sway_phase_rad, none, none, further[:, 4:6]
    )
    return motor_model.make_initial_state(
        people, rhythms if sways else None, interpolate(SPEED_FACTOR_RANGE, further[:, 3]), further[:, :3]
    )


def _mouth_goals(
    state: CooperationState,
    goals_rad: FloatArray,
    observation: PersonObservation,
    tool_w: FloatArray,
    posture: Posture,
) -> FloatArray:
    """Returns the goal joint angles (N, 20) that turn the face to the tool. If the tool is near and in front, the waist
    leans towards it.
    """
    xp, most, head = (
        get_namespace(tool_w),
        constant_like(MAX_HEAD_TURN_RAD, tool_w),
        constant_like(_HEAD, tool_w),
    )
    visible = xp.isfinite(tool_w).all(axis=-1)
    offset = xp.where(visible[:, None], tool_w, observation.mouth_pos_w) - observation.head_pos_w
    ahead = transform_to_torso_frame(state.joint_targets_rad, offset, posture)
    turn = xp.clip(state.facing_share[:, None] * compute_head_angles_toward(ahead), -most, most)
    near = visible & (transforms.norm(ahead) < MOUTH_APPROACH_DISTANCE_M) & (ahead[:, 1] < 0.0)
    goals = copy_as_float(goals_rad)
    goals[:, head] = xp.where(visible[:, None], turn, goals[:, head])
    goals[:, _WAIST_X] = xp.where(near, LEAN_ANGLE_RAD, goals[:, _WAIST_X])
    return goals


def _arm_goals(
    state: CooperationState, goals_rad: FloatArray, observation: PersonObservation, tool_w: FloatArray
) -> FloatArray:
    """Returns the goal joint angles (N, 20). If the tool is near, the right arm is lifted sideways and stretched a
    little."""
    xp, lift = get_namespace(tool_w), constant_like(_LIFT, tool_w)
    gap = xp.min(transforms.norm(observation.right_arm_pos_w - tool_w[:, None]), axis=-1)
    raised = state.initial_angles_rad[:, lift] + ARM_LIFT_ANGLE_RAD
    goals = copy_as_float(goals_rad)
    goals[:, lift] = xp.where((gap < ARM_APPROACH_DISTANCE_M)[:, None], raised, goals[:, lift])
    return goals


def transform_to_torso_frame(
    joint_angles_rad: FloatArray, offset_w: FloatArray, posture: Posture
) -> FloatArray:
    """Returns offsets (N, 3), converted from the world frame to the torso frame. In the torso frame, −y points
    forwards.
    """
    hips, torso = (human.compute_body_rotation(body, joint_angles_rad, posture) for body in ("hips", "torso"))
    return transforms.rotate(transforms.conjugate(transforms.multiply(hips, torso)), offset_w)


def compute_head_angles_toward(ahead: FloatArray) -> FloatArray:
    """Returns head joint angles (N, 3) that turn the face to points.

    ``ahead`` (N, 3) are the offsets of the points from the head, in the torso frame.
    """
    xp = get_namespace(ahead)
    facing = xp.zeros_like(ahead)
    facing[:, 0] = elementary.arctan2(-ahead[:, 2], -ahead[:, 1])
    distance = xp.maximum(transforms.norm(ahead), 1e-9)
    facing[:, 2] = elementary.arcsin(xp.clip(ahead[:, 0] / distance, -1.0, 1.0))
    return facing
