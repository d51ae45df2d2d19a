"""Motion of people with clinical impairments: changes the joint targets that a behaviour model computes.

The executed angles follow the commanded targets. Spastic and paretic joints move slowly and less far. Ataxic joints
overshoot and tremble near the goal. Dyskinesia adds slow involuntary motion. Paralysed joints do not move.
``people.clinical_impairments`` contains the parameters.
"""

from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary
from avrgym.geometry.arrays import get_namespace

UNLIMITED_SPEED_RAD_S = 1e3
"""Speed limit of joints without an impairment. No joint reaches it."""
NATURAL_FREQUENCY_RAD_S = 2.0 * np.pi * 1.5
"""Natural frequency of ataxic joints (assumption).

After a goal that moved at constant speed, these joints overshoot in proportion to this speed. Hypermetria increases
with speed in the same way (Topka et al., Exp. Brain Res. 119:483, 1998).
"""
GOAL_MOTION_DECAY_S, HALF_AMPLITUDE_GOAL_MOTION_RAD, HALF_AMPLITUDE_TARGET_SPEED_RAD_S = (
    1.0,
    float(np.radians(5.0)),
    0.2,
)
"""Parameters of the intention tremor (assumptions).

The amplitude exceeds half of its maximum if the goal moved by more than 5° in the last second. The amplitude is halved
while the target moves at 0.2 rad/s.
"""
DYSKINESIA_HZ, DYSKINESIA_WEIGHTS = (0.3, 0.7, 1.3), (0.5, 0.3, 0.2)
"""Dyskinesia is a sum of three sinusoids.

Its frequencies are below 3 Hz (Manson et al., J. Neurol. Neurosurg. Psychiatry 68:196, 2000: 1 to 3 Hz), and below
those of voluntary motion (Keijsers et al., Hum. Mov. Sci. 22:67, 2003). The frequencies and weights are assumptions.
"""
AMPLITUDE_ONSET_S = 1.0
"""Time until dyskinesia reaches its full amplitude."""
INTEGRATION_STEP_S = 0.01


@dataclass(frozen=True)
class MotorSigns:
    """Motor signs of N people, by joint.

    Attributes:
        mobility: executed share of the commanded displacement from the initial pose (N, 20).
        torque_fraction: torques towards the lower and the upper joint limit, as a share of the full torques (N, 20, 2).
        damping_n_m_s: passive damping of each joint, N m s/rad (N, 20).
        max_speed_rad_s: maximum speed of the executed motion (N, 20).
        damping_ratio: damping ratio (N, 20). Below 1, the joint overshoots as a second-order system.
        intention_tremor_rad: largest amplitude of the intention tremor (N, 20).
        dyskinesia_rad: largest involuntary displacement (N, 20).
        tremor_hz: frequency of the intention tremor (N,).
        oscillation_phase: phases of tremor and dyskinesia, 0 to 1 (N, 20).
    """

    mobility: FloatArray
    torque_fraction: FloatArray
    damping_n_m_s: FloatArray
    max_speed_rad_s: FloatArray
    damping_ratio: FloatArray
    intention_tremor_rad: FloatArray
    dyskinesia_rad: FloatArray
    tremor_hz: FloatArray
    oscillation_phase: FloatArray


@dataclass(frozen=True)
class ImpairedMotionState:
    """State of the impaired motion of N people.

    Attributes:
        executed_angles_rad: executed joint angles without tremor and dyskinesia (N, 20).
        speed_rad_s: speeds of these angles (N, 20).
        goal_angles_rad: goal joint angles of the previous step (N, 20).
        recent_goal_motion_rad: absolute motion of the goal angles during about the last second (N, 20).
        time_s: time since the start of the episode (N,).
    """

    executed_angles_rad: FloatArray
    speed_rad_s: FloatArray
    goal_angles_rad: FloatArray
    recent_goal_motion_rad: FloatArray
    time_s: FloatArray


def make_unimpaired_signs(phase: FloatArray) -> MotorSigns:
    """Returns the motor signs of n people without impairments. ``phase`` (n, 20) are random numbers in [0, 1)."""
    xp = get_namespace(phase)
    none, full = xp.zeros_like(phase), xp.ones_like(phase)
    return MotorSigns(
        mobility=full,
        torque_fraction=xp.stack([full, full], axis=-1),
        damping_n_m_s=none,
        max_speed_rad_s=UNLIMITED_SPEED_RAD_S * full,
        damping_ratio=full,
        intention_tremor_rad=none,
        dyskinesia_rad=none,
        tremor_hz=none[:, 0],
        oscillation_phase=phase,
    )


def make_initial_state(rest_rad: FloatArray) -> ImpairedMotionState:
    """Returns the state of n people at rest in their initial pose (n, 20)."""
    none = get_namespace(rest_rad).zeros_like(rest_rad)
    return ImpairedMotionState(rest_rad, none, rest_rad, none, none[:, 0])


def step_impaired_motion(
    signs: MotorSigns,
    state: ImpairedMotionState,
    targets_rad: FloatArray,
    rest_rad: FloatArray,
    step_s: float,
) -> tuple[ImpairedMotionState, FloatArray]:
    """Returns the state after ``step_s``, and the executed joint angles (N, 20) without joint limits.

    ``targets_rad`` (N, 20) are the commanded targets, ``rest_rad`` (N, 20) is the initial pose.
    """
    xp = get_namespace(targets_rad)
    goal = rest_rad + signs.mobility * (targets_rad - rest_rad)
    change = xp.abs(goal - state.goal_angles_rad)
    executed, speed = _follow(signs, state, goal, step_s)
    state = replace(
        state,
        executed_angles_rad=executed,
        speed_rad_s=speed,
        goal_angles_rad=goal,
        recent_goal_motion_rad=state.recent_goal_motion_rad * (1.0 - step_s / GOAL_MOTION_DECAY_S) + change,
        time_s=state.time_s + step_s,
    )
    involuntary = _intention_tremor_rad(signs, state, change / step_s) + _dyskinesia_rad(signs, state)
    return state, executed + involuntary


def _follow(
    signs: MotorSigns, state: ImpairedMotionState, goal: FloatArray, step_s: float
) -> tuple[FloatArray, FloatArray]:
    """Returns the executed joint angles and joint speeds after ``step_s``, (N, 20) each.

    Ataxic joints are second-order systems. Other joints reach the goal immediately, within their maximum speed.
    """
    xp, ataxic = get_namespace(goal), signs.damping_ratio < 1.0
    substeps = max(1, round(step_s / INTEGRATION_STEP_S))
    substep_s = step_s / substeps
    most = signs.max_speed_rad_s * substep_s
    executed, speed = state.executed_angles_rad, state.speed_rad_s
    for _ in range(substeps):
        way = goal - executed
        pull = NATURAL_FREQUENCY_RAD_S**2 * way
        pull = pull - 2.0 * NATURAL_FREQUENCY_RAD_S * signs.damping_ratio * speed
        speed = xp.where(ataxic, speed + substep_s * pull, 0.0)
        executed = executed + xp.clip(xp.where(ataxic, substep_s * speed, way), -most, most)
    return executed, speed


def _intention_tremor_rad(
    signs: MotorSigns, state: ImpairedMotionState, goal_speed_rad_s: FloatArray
) -> FloatArray:
    """Returns the displacement of the joints by intention tremor (N, 20), radians. The tremor grows when a movement
    slows down near its goal.
    """
    active = state.recent_goal_motion_rad / (state.recent_goal_motion_rad + HALF_AMPLITUDE_GOAL_MOTION_RAD)
    terminal = 1.0 / (1.0 + goal_speed_rad_s / HALF_AMPLITUDE_TARGET_SPEED_RAD_S)
    angle = 2.0 * np.pi * ((signs.tremor_hz * state.time_s)[:, None] + signs.oscillation_phase)
    return signs.intention_tremor_rad * active * terminal * elementary.sin(angle)


def _dyskinesia_rad(signs: MotorSigns, state: ImpairedMotionState) -> FloatArray:
    """Returns the displacement of the joints by dyskinesia (N, 20), radians. Frequencies differ by up to ±20 % between
    joints.
    """
    xp = get_namespace(signs.oscillation_phase)
    pace = 0.8 + 0.4 * signs.oscillation_phase
    wave = sum(
        weight
        * elementary.sin(
            2.0 * np.pi * (hz * pace * state.time_s[:, None] + (number + 1) * signs.oscillation_phase)
        )
        for number, (hz, weight) in enumerate(zip(DYSKINESIA_HZ, DYSKINESIA_WEIGHTS, strict=True))
    )
    onset = xp.minimum(state.time_s / AMPLITUDE_ONSET_S, xp.ones_like(state.time_s))
    return signs.dyskinesia_rad * onset[:, None] * wave
