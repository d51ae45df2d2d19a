"""Motor model of simulated people: computes joint targets at 100 Hz from goal joint angles.

Behaviour models choose goals at 10 Hz, from observations that are one reaction delay old. The equilibrium point of each
joint moves to the goal at constant speed (Gribble et al., J. Neurophysiol. 79:1409, 1998). The joint target follows the
equilibrium point as a critically damped second-order system. The target's speed is bell-shaped. The target never
overshoots, and is never faster than the equilibrium point. Its acceleration never exceeds the limit, even if a movement
reverses.

Speed and acceleration limits of people who do not hurry:

- head 1.2 rad/s and 8 rad/s². Walking and running people reach 1.6 rad/s. The acceleration is a quarter of that of
  running people at 3.2 Hz (Grossman et al., Exp. Brain Res. 70:470, 1988). In walking, hopping and running, heads turn
  with up to 3.2 rad/s (Pozzo et al., Prog. Brain Res. 80:377, 1989);
- arms 0.8 rad/s and 3.5 rad/s². People who reach for a glass move at 1.2 rad/s: 0.66 m/s with an arm of 0.55 m (de los
  Reyes-Guzmán et al., J. NeuroEng. Rehabil. 7:41, 2010). The acceleration is that of such a reach in 1.04 s with
  minimum jerk (Flash and Hogan, J. Neurosci. 5:1688, 1985);
- waist 0.35 rad/s and 2 rad/s²: our assumption. After a sudden push the trunk's voluntary flexion peaks at 5.9 rad/s²
  (J. Med. Eng. 2013:915428).

Startled people turn the head with at most 3 rad/s and 30 rad/s². Vigorous head turns reach 13.6 rad/s at 2.6 Hz
(Grossman et al.). All joints of startled people move 2.5 times faster.

The joint targets also contain:

- signal-dependent noise: the standard deviation of the speed is proportional to the speed (Harris and Wolpert, Nature
  394:780, 1998; van Beers et al., J. Neurophysiol. 91:1050, 2004). The factor of 10 % is our assumption;
- sway of the waist and motion of the head with the jaw, with the amplitudes of the behaviour model;
- physiological tremor of 8 to 12 Hz. Accelerations of outstretched hands peak at 0.0015 to 0.035 g, most often at 0.01
  g (Wade et al., Arch. Neurol. 39:358, 1982). Here the elbow's target moves the hand with 0.005 to 0.035 g. The servo
  of the joint transmits 30 % of this tremor. The head turns by the same angle: our assumption;
- tremor of people with this impairment. By default its frequency is 5 Hz, as in Assistive Gym: targets alternate every
  0.1 s.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary
from avrgym.geometry.arrays import constant_like, get_namespace, interpolate
from avrgym.models.human import JOINT_INDEX, JOINTS, People
from avrgym.models.scene import PHYSICS_STEP_S

MOTION_VERSION = 2
"""Version of the motion of simulated people. In version 1, joint targets change every 0.1 s, see
``people.motion_version_1``."""
MAX_JOINT_SPEED_RAD_S = np.array(
    [{"torso": 0.35, "head": 1.2}.get(each.body, 0.8) for each in JOINTS.values()]
)
MAX_JOINT_ACCELERATION_RAD_S2 = np.array(
    [{"torso": 2.0, "head": 8.0}.get(each.body, 3.5) for each in JOINTS.values()]
)
STARTLE_SPEED_FACTOR, STARTLE_ACCELERATION_FACTOR = 2.5, 3.75
"""Factors that multiply speed and acceleration while people are startled."""
SPEED_NOISE_FRACTION, SPEED_NOISE_HZ = 0.1, (0.7, 1.3, 2.1)
"""Standard deviation of the speed noise as a share of the speed, and frequencies of the noise."""
NOISE_FREE_SPEED_FRACTION = 1.0 / (1.0 + SPEED_NOISE_FRACTION * math.sqrt(2.0 * len(SPEED_NOISE_HZ)))
"""Speed without noise, divided by the speed limit. With the largest noise, the speed reaches the limit."""
AMPLITUDE_ONSET_S = 1.0
"""Time until sway, jaw motion and tremor reach their full amplitude."""
MAX_ONSET_RATE_PER_S = 1.875 / AMPLITUDE_ONSET_S
PHYSIOLOGICAL_TREMOR_HZ, PHYSIOLOGICAL_TREMOR_ACCELERATION_RANGE_G = (8.0, 12.0), (0.005, 0.035)
FOREARM_LENGTH_M, GRAVITY_M_S2 = 0.3, 9.81
"""Distance of the hand from the elbow in metres, and gravitational acceleration in m/s²."""
DEFAULT_TREMOR_HZ = 5.0
GOLDEN_RATIO_FRACTION = 0.6180339887498949
"""Fractional part of the golden ratio. Its multiples give evenly distributed phases (Weyl)."""


def _follow_share(acceleration_factor: float, speed_factor: float) -> FloatArray:
    """Returns the filter gain (20,) of each of two first-order filters in 10 ms.

    The gain is the share of the distance to the equilibrium point that a filter covers. The input of a critically
    damped system with natural frequency w may reverse between the speeds −v and v. The largest acceleration is then 2 w
    v / e.
    """
    frequency_rad_s = (
        0.5
        * math.e
        * acceleration_factor
        * MAX_JOINT_ACCELERATION_RAD_S2
        / (speed_factor * MAX_JOINT_SPEED_RAD_S)
    )
    return frequency_rad_s * PHYSICS_STEP_S / (1.0 + frequency_rad_s * PHYSICS_STEP_S)


_FOLLOW = _follow_share(1.0, 1.0)
STARTLE_FILTER_GAIN = _follow_share(STARTLE_ACCELERATION_FACTOR, STARTLE_SPEED_FACTOR)
"""Filter gain (20,) of joints of startled people in 10 ms, see ``_follow_share``."""
_WAIST_X, _WAIST_Y, _HEAD_X = (JOINT_INDEX[name] for name in ("waist_x", "waist_y", "head_x"))
_PHYSIOLOGICAL = np.array(
    [1.0 if name in ("head_x", "right_elbow_x", "left_elbow_x") else 0.0 for name in JOINTS]
)
"""Mask (20,) of the joints with physiological tremor: 1 with tremor, 0 without."""
_NOISE_PHASE = (
    2.0
    * np.pi
    * GOLDEN_RATIO_FRACTION
    * np.arange(len(JOINTS) * len(SPEED_NOISE_HZ)).reshape(len(JOINTS), -1)
)
"""Phases (20, 3) of the speed noise of each joint and frequency, in radians. They differ between joints."""


@dataclass(frozen=True)
class RhythmicMotion:
    """Rhythmic motion of N people, arrays (N,); ``sway_phase_rad`` is (N, 2).

    ``sway_amplitude_rad`` is the amplitude of the waist's sway, ``jaw_amplitude_rad`` that of the head's motion with
    the jaw. Physiological tremor has the amplitude ``physiological_tremor_rad`` and the frequency
    ``physiological_tremor_hz``.
    """

    sway_amplitude_rad: FloatArray
    sway_hz: FloatArray
    sway_phase_rad: FloatArray
    jaw_amplitude_rad: FloatArray
    jaw_frequency_hz: FloatArray
    physiological_tremor_rad: FloatArray
    physiological_tremor_hz: FloatArray


@dataclass(frozen=True)
class MotorState:
    """State of the motor model for N people.

    Attributes:
        goal_angles_rad: goal joint angles (N, 20).
        equilibrium_angles_rad: equilibrium points (N, 20).
        first_filter_angles_rad, second_filter_angles_rad: outputs (N, 20) of two first-order filters in series. The
            input of the first filter is the equilibrium points.
        max_step_rad: largest motion of the equilibrium points in 10 ms (N, 20).
        filter_gain: share of the remaining distance that a filter covers in 10 ms (N, 20).
        speed_factor: factor (N,) that multiplies the limits of speed and acceleration.
        noise_phase_rad: phases of the speed noise (N, 3).
        rhythm_amplitude_rad, rhythm_hz, rhythm_phase_rad: amplitudes (N, W, 20), frequencies (N, W) and phases (N, W)
            of W rhythmic motions.
        time_s: time since the start of the episode (N,).
    """

    goal_angles_rad: FloatArray
    equilibrium_angles_rad: FloatArray
    first_filter_angles_rad: FloatArray
    second_filter_angles_rad: FloatArray
    max_step_rad: FloatArray
    filter_gain: FloatArray
    speed_factor: FloatArray
    noise_phase_rad: FloatArray
    rhythm_amplitude_rad: FloatArray
    rhythm_hz: FloatArray
    rhythm_phase_rad: FloatArray
    time_s: FloatArray


def derive_random_numbers(uniforms: FloatArray) -> FloatArray:
    """Returns other uniform random numbers in [0, 1] of the same shape. They consist of the bits after the first 13
    bits.
    """
    scaled = 8192.0 * uniforms
    return scaled - get_namespace(scaled).floor(scaled)


def sample_rhythms(
    sway_rad: FloatArray,
    sway_hz: FloatArray,
    sway_phase_rad: FloatArray,
    jaw_rad: FloatArray,
    jaw_hz: FloatArray,
    uniforms: FloatArray,
) -> RhythmicMotion:
    """Returns the rhythmic motion of N people with the given sway and jaw motion, arrays (N,).

    Physiological tremor is sampled from uniform numbers (N, 2).
    """
    low, high = PHYSIOLOGICAL_TREMOR_ACCELERATION_RANGE_G
    acceleration_m_s2 = (
        GRAVITY_M_S2 * low * elementary.power(high / low + 0.0 * uniforms[:, 0], uniforms[:, 0])
    )
    tremor_hz = interpolate(PHYSIOLOGICAL_TREMOR_HZ, uniforms[:, 1])
    angular = 2.0 * np.pi * tremor_hz
    tremor_rad = acceleration_m_s2 / (FOREARM_LENGTH_M * angular * angular)
    return RhythmicMotion(sway_rad, sway_hz, sway_phase_rad, jaw_rad, jaw_hz, tremor_rad, tremor_hz)


def make_initial_state(
    people: People,
    rhythms: RhythmicMotion | None,
    speed_factor: FloatArray,
    noise_uniforms: FloatArray,
    tremor_hz: FloatArray | float = DEFAULT_TREMOR_HZ,
) -> MotorState:
    """Returns the initial state of people at rest in their pose.

    Args:
        people: body parameters of N people.
        rhythms: their rhythmic motion. If it is ``None``, the tremor in ``people`` is the only rhythmic motion.
        speed_factor: speed and acceleration relative to the limits (N,).
        noise_uniforms: uniform numbers (N, 3) that determine the noise.
        tremor_hz: frequency of the tremor in ``people`` (N,).
    """
    angles = people.joint_angles_rad
    xp, none, nothing = get_namespace(angles), 0.0 * speed_factor, 0.0 * angles
    waves = [(people.tremor_rad + nothing, none + tremor_hz, none)]
    if rhythms is not None:
        forwards, sideways, nodding = nothing + 0.0, nothing + 0.0, nothing + 0.0
        forwards[:, _WAIST_X] = sideways[:, _WAIST_Y] = rhythms.sway_amplitude_rad
        nodding[:, _HEAD_X] = 0.5 * rhythms.jaw_amplitude_rad
        trembling = rhythms.physiological_tremor_rad[:, None] * constant_like(_PHYSIOLOGICAL, angles)
        phase = rhythms.sway_phase_rad
        waves += [
            (forwards, rhythms.sway_hz, phase[:, 0]),
            (sideways, 0.7 * rhythms.sway_hz, phase[:, 1]),
            (nodding, rhythms.jaw_frequency_hz, none),
            (trembling, rhythms.physiological_tremor_hz, none),
        ]
    amplitudes, frequencies, phases = (xp.stack(list(each), axis=1) for each in zip(*waves, strict=True))
    return MotorState(
        goal_angles_rad=angles,
        equilibrium_angles_rad=angles,
        first_filter_angles_rad=angles,
        second_filter_angles_rad=angles,
        max_step_rad=nothing,
        filter_gain=nothing + constant_like(_FOLLOW, angles),
        speed_factor=speed_factor,
        noise_phase_rad=2.0 * np.pi * noise_uniforms,
        rhythm_amplitude_rad=amplitudes,
        rhythm_hz=frequencies,
        rhythm_phase_rad=phases,
        time_s=none,
    )


def set_goal_angles(state: MotorState, goal_rad: FloatArray, startled: BoolArray | None = None) -> MotorState:
    """Returns the state with new goal joint angles (N, 20). People in the mask ``startled`` (N,) move with the speed
    and acceleration of startled people.
    """
    xp, speed = get_namespace(goal_rad), constant_like(MAX_JOINT_SPEED_RAD_S, goal_rad)
    factor, filter_gain = state.speed_factor, constant_like(_FOLLOW, goal_rad) + 0.0 * goal_rad
    if startled is not None:
        factor = xp.where(startled, STARTLE_SPEED_FACTOR, factor)
        filter_gain = xp.where(startled[:, None], constant_like(STARTLE_FILTER_GAIN, goal_rad), filter_gain)
    varying = NOISE_FREE_SPEED_FRACTION * (1.0 + SPEED_NOISE_FRACTION * _noise(state))
    return replace(
        state,
        goal_angles_rad=goal_rad,
        max_step_rad=PHYSICS_STEP_S * factor[:, None] * speed * varying,
        filter_gain=filter_gain,
    )


def _noise(state: MotorState) -> FloatArray:
    """Returns speed noise of the joints (N, 20) with variance 1 and frequencies below 3 Hz.

    It is a sum of sines with random phases (Shinozuka and Deodatis, Appl. Mech. Rev. 44:191, 1991).
    """
    total = 0.0 * state.goal_angles_rad
    for number, frequency_hz in enumerate(SPEED_NOISE_HZ):
        angle = 2.0 * np.pi * frequency_hz * state.time_s + state.noise_phase_rad[:, number]
        shift = constant_like(np.ascontiguousarray(_NOISE_PHASE[:, number]), total)
        total = total + elementary.sin(angle[:, None] + shift)
    return total * math.sqrt(2.0 / len(SPEED_NOISE_HZ))


def advance_motor_state(state: MotorState) -> MotorState:
    """Returns the state of the motor model after another 10 ms."""
    xp = get_namespace(state.goal_angles_rad)
    way = state.goal_angles_rad - state.equilibrium_angles_rad
    equilibrium = state.equilibrium_angles_rad + xp.clip(way, -state.max_step_rad, state.max_step_rad)
    lagged = state.first_filter_angles_rad + state.filter_gain * (equilibrium - state.first_filter_angles_rad)
    angles = state.second_filter_angles_rad + state.filter_gain * (lagged - state.second_filter_angles_rad)
    return replace(
        state,
        equilibrium_angles_rad=equilibrium,
        first_filter_angles_rad=lagged,
        second_filter_angles_rad=angles,
        time_s=state.time_s + PHYSICS_STEP_S,
    )


def advance_joint_targets_rad(state: MotorState, count: int) -> tuple[MotorState, FloatArray]:
    """Returns the state after ``count`` steps of 10 ms, and the joint targets (``count``, N, 20) after each step.

    Targets contain movements to goals, sway, head motion by chewing, and tremor.
    """
    states: list[MotorState] = []
    for _ in range(count):
        state = advance_motor_state(state)
        states.append(state)
    xp = get_namespace(state.goal_angles_rad)
    targets, time_s = (
        xp.stack([getattr(each, name) for each in states]) for name in ("second_filter_angles_rad", "time_s")
    )
    angle = 2.0 * np.pi * state.rhythm_hz * time_s[..., None] + state.rhythm_phase_rad
    swung = elementary.sin(angle) * _onset(time_s)[..., None]
    for number in range(state.rhythm_hz.shape[1]):
        targets = targets + swung[..., number, None] * state.rhythm_amplitude_rad[:, number]
    return state, targets


def _onset(time_s: FloatArray) -> FloatArray:
    """Returns the amplitude (N,) of rhythmic motion as a share of the full amplitude. It increases from 0 to 1 with
    minimum jerk.
    """
    share = get_namespace(time_s).minimum(time_s / AMPLITUDE_ONSET_S, 1.0)
    return share * share * share * (10.0 + share * (6.0 * share - 15.0))


def compute_speed_limit_rad_s(state: MotorState, startled: BoolArray | None = None) -> FloatArray:
    """Returns the maximum speed (N, 20) of the joint targets: the maximum speed of movements plus those of all rhythmic
    motions.
    """
    factor = (
        state.speed_factor
        if startled is None
        else np.where(startled, STARTLE_SPEED_FACTOR, state.speed_factor)
    )
    waves = state.rhythm_amplitude_rad * (2.0 * np.pi * state.rhythm_hz + MAX_ONSET_RATE_PER_S)[..., None]
    return factor[:, None] * MAX_JOINT_SPEED_RAD_S + waves.sum(axis=1)
