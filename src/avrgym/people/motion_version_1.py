"""Version 1 of the motion of simulated people, for comparison: joint targets change every 0.1 s.

Populations with the suffix ``@1``, such as ``participants@1``, use this version. In cooperating populations, targets
jump to the next pose. In the zoo, targets are interpolated with limited acceleration. They also contain sway, chewing
and alternating tremor.
"""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary
from avrgym.geometry.arrays import RAD_PER_DEGREE, constant_like, get_namespace
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import cooperation
from avrgym.people.cooperation import CooperationState, OfferedBodyPart, PersonObservation
from avrgym.people.motor_model import (
    MAX_JOINT_ACCELERATION_RAD_S2,
    MAX_JOINT_SPEED_RAD_S,
    STARTLE_ACCELERATION_FACTOR,
    STARTLE_SPEED_FACTOR,
)
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partner_behaviour import JointLimiter, PartnerState
from avrgym.people.zoo.partners import BehaviourParameters

MAX_PARTICIPANT_SPEED_RAD_S = np.array(
    [{"torso": 0.2, "head": 0.8}.get(joint.body, 0.4) for joint in JOINTS.values()], dtype=float
)
AMPLITUDE_ONSET_S = 1.0
"""Time until chewing and tremor reach their full amplitude."""

_WAIST_X, _WAIST_Y, _HEAD_X = (JOINT_INDEX[name] for name in ("waist_x", "waist_y", "head_x"))


def step_participants(
    state: CooperationState,
    people: People,
    observation: PersonObservation | None,
    offered: OfferedBodyPart,
    posture: Posture,
) -> tuple[CooperationState, FloatArray]:
    """Returns the next state of people, and the joint targets (N, 20). Without ``observation``, people do not react."""
    state = cooperation.advance_time(state)
    targets = state.joint_targets_rad + _tremor_direction(state.time_s) * people.tremor_rad
    if observation is not None:
        state, goals = cooperation.choose_goal_angles(
            state, state.joint_targets_rad, observation, offered, posture
        )
        reach = constant_like(MAX_PARTICIPANT_SPEED_RAD_S * CONTROL_STEP_S, state.joint_targets_rad)
        moved = state.joint_targets_rad + get_namespace(goals).clip(
            goals - state.joint_targets_rad, -reach, reach
        )
        state = replace(state, joint_targets_rad=moved)
        targets = targets + _sway_rad(state)
    return state, targets


def step_partners(
    state: PartnerState,
    people: People,
    observation: PersonObservation,
    offered: OfferedBodyPart,
    posture: Posture,
    limit: JointLimiter,
) -> tuple[PartnerState, FloatArray]:
    """Returns the next state of zoo partners, and the joint targets (N, 20)."""
    state, desired = partner_behaviour.choose_goal_angles(state, observation, offered, posture)
    state = _track(state, limit(desired))
    tremor = _tremor_direction(state.time_s) * _onset_share(state)[:, None] * people.tremor_rad
    return state, state.joint_targets_rad + _oscillation_rad(state) + tremor


def _tremor_direction(time_s: FloatArray) -> FloatArray:
    """Returns the sign (N, 1) of the tremor. It alternates between −1 and 1 from step to step (paper's code)."""
    odd = get_namespace(time_s).round(time_s / CONTROL_STEP_S) % 2
    return (2.0 * odd - 1.0)[:, None]


def _sway_rad(state: CooperationState) -> FloatArray:
    """Returns the sway of the joints (N, 20): the waist moves forwards, backwards and sideways."""
    xp = get_namespace(state.joint_targets_rad)
    angle = 2.0 * np.pi * state.sway_hz * state.time_s
    phase = state.sway_phase_rad[:, :2].T
    shift = elementary.sin(xp.stack([angle, 0.7 * angle]) + phase) - elementary.sin(phase)
    wave = xp.zeros_like(state.joint_targets_rad)
    wave[:, _WAIST_X], wave[:, _WAIST_Y] = (
        state.sway_amplitude_rad * shift[0],
        state.sway_amplitude_rad * shift[1],
    )
    return wave


def _oscillation_rad(state: PartnerState) -> FloatArray:
    """Returns the motion of the joints (N, 20) by sway and chewing. It is zero at the start of the episode."""
    xp, parameters = get_namespace(state.joint_targets_rad), BehaviourParameters.from_table(state.parameters)
    wave = xp.zeros_like(state.joint_targets_rad)
    phase = 2.0 * np.pi * state.random_numbers[:, :2].T
    angle = 2.0 * np.pi * parameters.sway_hz * state.time_s
    swung = elementary.sin(xp.stack([angle, 0.7 * angle]) + phase) - elementary.sin(phase)
    extent = RAD_PER_DEGREE * parameters.sway_deg
    wave[:, _WAIST_X], wave[:, _WAIST_Y] = extent * swung[0], extent * swung[1]
    opened = 0.5 - 0.5 * elementary.cos(2.0 * np.pi * parameters.chew_hz * state.time_s)
    wave[:, _HEAD_X] = -(RAD_PER_DEGREE * parameters.chew_deg) * opened * _onset_share(state)
    return wave


def _onset_share(state: PartnerState) -> FloatArray:
    """Returns the amplitude (N,) of chewing and tremor as a share of the full amplitude. It increases from 0 to 1 in
    the first second.
    """
    return get_namespace(state.time_s).minimum(state.time_s / AMPLITUDE_ONSET_S, 1.0)


def _track(state: PartnerState, desired: FloatArray) -> PartnerState:
    """Returns the state with targets moved towards the desired angles.

    Their speeds decrease early enough to stop at these angles.
    """
    xp, parameters = get_namespace(desired), BehaviourParameters.from_table(state.parameters)
    startled = (state.time_since_startle_s <= parameters.startle_duration_s)[:, None]
    speed_factor = parameters.speed_share[:, None]
    most = constant_like(MAX_JOINT_SPEED_RAD_S, desired) * xp.where(
        startled, STARTLE_SPEED_FACTOR, speed_factor
    )
    sudden = xp.where(startled, STARTLE_ACCELERATION_FACTOR, speed_factor)
    change = constant_like(MAX_JOINT_ACCELERATION_RAD_S2, desired) * sudden * CONTROL_STEP_S
    way = desired - state.joint_targets_rad
    braked = xp.sqrt(0.25 * change * change + 2.0 * change / CONTROL_STEP_S * xp.abs(way)) - 0.5 * change
    speed = xp.copysign(xp.minimum(xp.minimum(most, braked), xp.abs(way) / CONTROL_STEP_S), way)
    speed = xp.clip(speed, state.target_speed_rad_s - change, state.target_speed_rad_s + change)
    return replace(
        state, joint_targets_rad=state.joint_targets_rad + CONTROL_STEP_S * speed, target_speed_rad_s=speed
    )
