"""Behaviour model of zoo partners: computes their goal joint angles from their observations.

``people.motor_model`` moves the joints to these goals, and adds sway, chewing and tremor.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import (
    RAD_PER_DEGREE,
    constant_like,
    copy_as_float,
    get_namespace,
    make_row_indices,
)
from avrgym.models.human import JOINT_INDEX, People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import cooperation, motor_model
from avrgym.people.cooperation import (
    ARM_APPROACH_DISTANCE_M,
    ARM_LIFT_ANGLE_RAD,
    LEAN_ANGLE_RAD,
    MAX_HEAD_TURN_RAD,
    MOUTH_APPROACH_DISTANCE_M,
    OfferedBodyPart,
    PersonObservation,
)
from avrgym.people.motor_model import GOLDEN_RATIO_FRACTION, MAX_JOINT_SPEED_RAD_S, MotorState
from avrgym.people.zoo.partners import BehaviourParameters

JointLimiter = Callable[[FloatArray], FloatArray]
"""Function that clips joint angles (N, 20) of N people to their joint ranges."""

TOOL_HISTORY_LENGTH = 11
"""Number of stored tool positions: the current position and those of the last second."""
MIN_STARTLE_INTERVAL_S = 3.0
"""Minimum time between two startles."""
NEVER_STARTLED_S = 1e6
_WAIST = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
_HEAD = np.array([JOINT_INDEX[f"head_{axis}"] for axis in "xyz"])
_SHOULDER, _ELBOW = JOINT_INDEX["right_shoulder_y"], JOINT_INDEX["right_elbow_x"]


@dataclass(frozen=True)
class PartnerState:
    """State of the behaviour model for N partners.

    Attributes:
        parameters: table (N, 23) of ``BehaviourParameters``.
        random_numbers: random numbers from 0 to 1 (N, 4) that determine times and directions of a person's movements.
        tool_history_w: latest tool positions (N, ``TOOL_HISTORY_LENGTH``, 3), newest first.
        initial_angles_rad: initial joint angles (N, 20).
        joint_targets_rad: joint targets without rhythmic motion (N, 20).
        target_speed_rad_s: speeds of the targets in version 1 of the motion (N, 20).
        time_s: time since the start of the episode (N,).
        tool_near_duration_s: time since the tool came near; 0 if the tool is not near (N,).
        time_since_startle_s: time since the latest startle (N,).
        startle_count: number of startles (N,).
    """

    parameters: FloatArray
    random_numbers: FloatArray
    tool_history_w: FloatArray
    initial_angles_rad: FloatArray
    joint_targets_rad: FloatArray
    target_speed_rad_s: FloatArray
    time_s: FloatArray
    tool_near_duration_s: FloatArray
    time_since_startle_s: FloatArray
    startle_count: FloatArray


class _ToolPercept(NamedTuple):
    """The tool as N people perceive it.

    ``aware`` (N,): whether the person perceives the tool. ``facing_rad`` (N, 3): head angles that face the tool.
    ``gap_m`` (N,): distance of the tool from the offered body part. ``side`` (N,): side of the tool, 1 for left, −1 for
    right.
    """

    aware: BoolArray
    facing_rad: FloatArray
    gap_m: FloatArray
    side: FloatArray


def make_initial_state(people: People, parameters: BehaviourParameters, uniforms: FloatArray) -> PartnerState:
    """Returns the initial state of n partners with the bodies of ``people`` and ``parameters``, arrays (n,).

    ``uniforms`` (n, 4) are random numbers. With them, partners with equal parameters behave differently.
    """
    xp = get_namespace(uniforms)
    is_at_rest, none = xp.zeros_like(people.joint_angles_rad), xp.zeros_like(uniforms[:, 0])
    return PartnerState(
        parameters=parameters.to_table(),
        random_numbers=uniforms,
        tool_history_w=xp.zeros(
            (len(uniforms), TOOL_HISTORY_LENGTH, 3), dtype=uniforms.dtype, device=uniforms.device
        ),
        initial_angles_rad=people.joint_angles_rad,
        joint_targets_rad=people.joint_angles_rad,
        target_speed_rad_s=is_at_rest,
        time_s=none,
        tool_near_duration_s=none,
        time_since_startle_s=xp.full_like(none, NEVER_STARTLED_S),
        startle_count=none,
    )


def choose_goal_angles(
    state: PartnerState, observation: PersonObservation, offered: OfferedBodyPart, posture: Posture
) -> tuple[PartnerState, FloatArray]:
    """Returns the next state and the goal joint angles (N, 20) of partners, given an observation of the tool.

    The goals are not yet limited to joint ranges and speeds.
    """
    parameters = BehaviourParameters.from_table(state.parameters)
    history = get_namespace(state.tool_history_w).concat(
        [observation.tool_pos_w[:, None], state.tool_history_w[:, :-1]], axis=1
    )
    state = replace(state, tool_history_w=history, time_s=state.time_s + CONTROL_STEP_S)
    percept = _perceive_tool(state, parameters, observation, offered, posture)
    state = _update_startle(state, parameters, percept, offered)
    return state, _desired_angles(state, parameters, percept, offered)


def are_startled(state: PartnerState) -> BoolArray:
    """Returns the boolean mask (N,) of partners that are startled now."""
    return state.time_since_startle_s <= BehaviourParameters.from_table(state.parameters).startle_duration_s


def make_initial_motor_state(state: PartnerState, people: People) -> MotorState:
    """Returns the initial state of the motor model for N partners."""
    parameters, uniforms = BehaviourParameters.from_table(state.parameters), state.random_numbers
    further = motor_model.derive_random_numbers(uniforms)
    rhythms = motor_model.sample_rhythms(
        RAD_PER_DEGREE * parameters.sway_deg,
        parameters.sway_hz,
        2.0 * np.pi * uniforms[:, :2],
        RAD_PER_DEGREE * parameters.chew_deg,
        parameters.chew_hz,
        further[:, 2:],
    )
    return motor_model.make_initial_state(
        people, rhythms, parameters.speed_share, further[:, :3], tremor_hz=parameters.tremor_hz
    )


def move_joint_targets(targets_rad: FloatArray, joints: Sequence[str], action: FloatArray) -> FloatArray:
    """Returns the targets (N, 20) after the K ``joints`` have moved for one control step.

    ``action`` (N, K) is the joint speed divided by ``MAX_JOINT_SPEED_RAD_S``, clipped to ±1.
    """
    columns = np.array([JOINT_INDEX[name] for name in joints], dtype=np.intp)
    targets = copy_as_float(targets_rad)
    reach = constant_like(CONTROL_STEP_S * MAX_JOINT_SPEED_RAD_S[columns], targets)
    targets[:, constant_like(columns, targets)] += reach * get_namespace(action).clip(action, -1.0, 1.0)
    return targets


def _perceive_tool(
    state: PartnerState,
    parameters: BehaviourParameters,
    observation: PersonObservation,
    offered: OfferedBodyPart,
    posture: Posture,
) -> _ToolPercept:
    """Returns the perceived tool. Its position is one reaction delay old, interpolated between two stored positions."""
    xp = get_namespace(state.time_s)
    back = parameters.reaction_s / CONTROL_STEP_S
    whole = xp.astype(back, xp.int64)
    share, row = (back - whole)[:, None], make_row_indices(back)
    tool = (1.0 - share) * state.tool_history_w[row, whole] + share * state.tool_history_w[row, whole + 1]
    aware = state.time_s > parameters.reaction_s + 1.5 * CONTROL_STEP_S
    tool = xp.where(aware[:, None], tool, observation.mouth_pos_w)
    ahead = cooperation.transform_to_torso_frame(
        state.joint_targets_rad, tool - observation.head_pos_w, posture
    )
    match offered:
        case "mouth":
            gap = xp.where(ahead[:, 1] < 0.0, transforms.norm(tool - observation.mouth_pos_w), np.inf)
        case "arm":
            gap = xp.min(transforms.norm(observation.right_arm_pos_w - tool[:, None]), axis=-1)
        case "left_arm" | "nothing":
            gap = xp.full_like(back, xp.inf)
    side = xp.where(ahead[:, 0] > 0.0, 1.0, -1.0)
    return _ToolPercept(
        aware, cooperation.compute_head_angles_toward(ahead), xp.where(aware, gap, np.inf), side
    )


def _update_startle(
    state: PartnerState, parameters: BehaviourParameters, percept: _ToolPercept, offered: OfferedBodyPart
) -> PartnerState:
    """Returns the state with updated durations: since the tool came near, and since the latest startle."""
    xp = get_namespace(percept.gap_m)
    near = percept.gap_m < (ARM_APPROACH_DISTANCE_M if offered == "arm" else MOUTH_APPROACH_DISTANCE_M)
    startled = (parameters.startle_deg > 0.0) & (percept.gap_m < parameters.startle_distance_m)
    startled &= state.time_since_startle_s > parameters.startle_duration_s + MIN_STARTLE_INTERVAL_S
    return replace(
        state,
        tool_near_duration_s=xp.where(near, state.tool_near_duration_s + CONTROL_STEP_S, 0.0),
        time_since_startle_s=xp.where(startled, 0.0, state.time_since_startle_s + CONTROL_STEP_S),
        startle_count=state.startle_count + startled,
    )


def _desired_angles(
    state: PartnerState, parameters: BehaviourParameters, percept: _ToolPercept, offered: OfferedBodyPart
) -> FloatArray:
    """Returns the desired joint angles (N, 20), without limits of range and speed."""
    desired = copy_as_float(state.initial_angles_rad)
    xp, most, head = (
        get_namespace(desired),
        constant_like(MAX_HEAD_TURN_RAD, desired),
        constant_like(_HEAD, desired),
    )
    faced = xp.clip(parameters.facing_share[:, None] * percept.facing_rad, -most, most)
    faces = percept.aware & (parameters.facing_share > 0.0)
    desired[:, head] = xp.where(faces[:, None], faced, desired[:, head])
    _glance(desired, state, parameters)
    _shift(desired, state, parameters)
    _approach(desired, state, parameters, offered)
    _withdraw(desired, state, parameters, percept, offered)
    return desired


def _glance(desired: FloatArray, state: PartnerState, parameters: BehaviourParameters) -> None:
    """Change ``desired`` by occasional head turns: to the side of a companion, or to a random side."""
    count, share = _periods(state, parameters.glance_period_s, 2)
    away = (parameters.glance_share > 0.0) & (share >= 1.0 - parameters.glance_share)
    side = 1.0 - 2.0 * (state.random_numbers[:, 3] < 0.5)
    anywhere = 2.0 * _uniform(state.random_numbers[:, 3], count) - 1.0
    yaw = RAD_PER_DEGREE * (side * parameters.glance_deg + anywhere * parameters.random_glance_deg)
    desired[:, _HEAD[2]] = get_namespace(desired).where(away, yaw, desired[:, _HEAD[2]])


def _shift(desired: FloatArray, state: PartnerState, parameters: BehaviourParameters) -> None:
    """Change ``desired`` by occasional posture shifts: the waist moves, and the right arm moves outwards."""
    count, _ = _periods(state, parameters.shift_period_s, 3)
    extent = RAD_PER_DEGREE * parameters.shift_deg
    for axis, joint in enumerate(_WAIST):
        desired[:, joint] += extent * (2.0 * _uniform(state.random_numbers[:, axis], count) - 1.0)
    desired[:, _SHOULDER] += extent * _uniform(state.random_numbers[:, 3], count)


def _approach(
    desired: FloatArray, state: PartnerState, parameters: BehaviourParameters, offered: OfferedBodyPart
) -> None:
    """Change ``desired``: lean towards a near tool, or lift the arm. Hesitant people pause at half the approach."""
    xp = get_namespace(desired)
    hesitates = parameters.pause_s > 0.0
    halves = xp.floor(state.tool_near_duration_s / xp.where(hesitates, parameters.pause_s, 1.0))
    come = xp.where(hesitates, xp.minimum(0.5 * halves, 1.0), state.tool_near_duration_s > 0.0)
    share = parameters.approach_share * come
    if offered == "mouth":
        desired[:, _WAIST[0]] += share * LEAN_ANGLE_RAD
    elif offered == "arm":
        desired[:, _SHOULDER] += share * ARM_LIFT_ANGLE_RAD
        desired[:, _ELBOW] += share * ARM_LIFT_ANGLE_RAD


def _withdraw(
    desired: FloatArray,
    state: PartnerState,
    parameters: BehaviourParameters,
    percept: _ToolPercept,
    offered: OfferedBodyPart,
) -> None:
    """Change ``desired``: bend away from the tool, and turn the face away or withdraw the forearm."""
    is_startled = (state.startle_count > 0.0) & (state.time_since_startle_s <= parameters.startle_duration_s)
    extent_deg = parameters.withdrawal_deg * (state.tool_near_duration_s > 0.0)
    startle_deg = parameters.startle_deg * 0.5 ** (state.startle_count - 1.0)
    extent_deg = extent_deg + get_namespace(startle_deg).where(is_startled, startle_deg, 0.0)
    extent = RAD_PER_DEGREE * extent_deg
    desired[:, _WAIST[1]] -= 0.5 * percept.side * extent
    if offered == "arm":
        desired[:, _ELBOW] -= extent
    else:
        desired[:, _HEAD[0]] -= extent
        desired[:, _HEAD[2]] -= percept.side * extent


def _periods(state: PartnerState, every_s: FloatArray, of: int) -> tuple[FloatArray, FloatArray]:
    """Returns the number of completed periods (N,), and the elapsed share of the current period (N,)."""
    rounds = state.time_s / every_s + state.random_numbers[:, of]
    count = get_namespace(rounds).floor(rounds)
    return count, rounds - count


def _uniform(first: FloatArray, count: FloatArray) -> FloatArray:
    """Returns pseudo-random numbers (N,) in 0..1 for events with the numbers ``count`` (N,)."""
    value = first + GOLDEN_RATIO_FRACTION * count
    return value - get_namespace(value).floor(value)
