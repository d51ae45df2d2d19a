"""Clinical impairments of simulated people: spasticity, hemiparesis, spinal cord injury, ataxia and dyskinesia.

Each parameter has a value for the mildest and one for the most severe impairment. Values between them are interpolated.
Values without a source are plausible assumptions.

- *Spasticity*, modified Ashworth scale 1 to 3 (Bohannon and Smith, Phys. Ther. 67:206, 1987). The damping of the elbow
  increases with this scale (McCrea et al., J. Neurosci. Methods 128:121, 2003). The elbow resists a stretch at 100°/s
  with 0.5 to 4 N m (assumption). Many people with spastic paresis do not reach 120°/s or even 30°/s at shoulder and
  elbow (Kim et al., J. Neurol. Phys. Ther. 29, 2005). These two speeds are the speed limits of arm joints at the lowest
  and highest severity.
- *Hemiparesis*: one arm is weak and slow. Its range of motion is reduced, in all segments alike (Beebe and Lang, Stroke
  40:1772, 2009). Peak torques of the affected arm are reduced at shoulder, elbow and wrist (McCrea et al., Muscle Nerve
  28:46, 2003). The remaining shares of motion and torque are assumptions. Head and trunk are unaffected.
- *Spinal cord injury*, complete, by neurological level. Key muscles (ISNCSCI: Rupp et al., Top. Spinal Cord Inj.
  Rehabil. 27(2):1, 2021): C5 elbow flexors, C6 wrist extensors, C7 elbow extensors. At the level of the injury, a key
  muscle has at least grade 3 (of 5), above it grade 5. The trunk and joints below the level have no voluntary control.
  The head is not affected. People with C5 abduct the shoulder, flex it a little, and supinate.
- *Ataxia*: movements overshoot at all joints (Topka et al., Exp. Brain Res. 119:483, 1998), by 10 to 45 % of a step
  (assumption). Intention tremor is slower than 5 Hz and largest near the goal (Deuschl et al., Mov. Disord. 13(S3):2,
  1998). Amplitudes are assumptions.
- *Dyskinesia*: involuntary motion of head, trunk and arms, see ``impaired_motion``. Amplitudes are assumptions.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import choose_index, constant_like, get_namespace, interpolate
from avrgym.models.human import JOINTS
from avrgym.people.impaired_motion import UNLIMITED_SPEED_RAD_S, MotorSigns, make_unimpaired_signs
from avrgym.people.population_names import SEVERITIES, ImpairmentName

SPASTIC_RESISTANCE_N_M, STRETCH_SPEED_RAD_S = (0.5, 4.0), float(np.radians(100.0))
"""Resistance torques of a spastic elbow to a stretch, at the lowest and the highest severity. The last value is the
speed of the stretch.
"""
SPASTIC_MOBILITY_RANGE = (1.0, 0.6)
"""Share of the commanded motion that spastic arms execute, at the lowest and the highest severity."""
AFFECTED_SPEED_LIMIT_RANGE_RAD_S = (float(np.radians(120.0)), float(np.radians(30.0)))
"""Speed limits of affected joints in rad/s, at the lowest and the highest severity."""
PARETIC_MOBILITY, PARETIC_STRENGTH = (0.9, 0.1), (0.7, 0.1)
PASSIVE_TORQUE_FRACTION = 0.05
"""Torque of joints without voluntary control, as a share of the healthy torque.

Passive tissue, backrest and armrests cause this torque (assumption).
"""
MUSCLE_GRADE_3_TORQUE_FRACTION = 0.25
"""Torque of muscles of grade 3, as a share of the healthy torque (assumption).

These muscles hold the limb against gravity. Grade 3 is far below half of the full torque (MacAvoy and Green, J. Hand
Surg. Eur. 32:149, 2007).
"""
ATAXIC_DAMPING_RATIO_RANGE = (0.59, 0.25)
"""Damping ratio ζ of ataxic joints.

A step overshoots by exp(−π ζ / √(1 − ζ²)): 10 and 45 %.
"""
INTENTION_TREMOR_RANGE_HZ = (3.0, 4.5)
INTENTION_TREMOR_AMPLITUDES_DEG: Mapping[str, tuple[float, float]] = {
    "torso": (0.3, 1.5), "head": (0.5, 3.0), "arm": (1.0, 6.0),
}  # fmt: skip
DYSKINESIA_AMPLITUDES_DEG: Mapping[str, tuple[float, float]] = {
    "torso": (1.5, 6.0), "head": (3.0, 12.0), "arm": (4.0, 16.0),
}  # fmt: skip

_STIFFNESS: Mapping[str, float] = {"shoulder": 1.5, "elbow": 1.0, "forearm": 0.2, "wrist": 0.3}
"""Damping of the arm's joints, divided by the damping of the elbow (assumption)."""
_IN_ARM = np.array([joint.body not in ("torso", "head") for joint in JOINTS.values()])
_SPINAL_LEVELS: tuple[Mapping[str, tuple[float, float, float]], ...] = (
    {  # C6
        "shoulder_x": (1.0, 1.0, 1.0), "shoulder_y": (1.0, 1.0, 1.0), "shoulder_z": (1.0, 1.0, 1.0),
        "elbow_x": (1.0, 1.0, PASSIVE_TORQUE_FRACTION), "forearm_z": (1.0, 1.0, 1.0),
        "wrist_x": (0.5, MUSCLE_GRADE_3_TORQUE_FRACTION, MUSCLE_GRADE_3_TORQUE_FRACTION),
    },
    {  # C5
        "shoulder_x": (0.5, 0.5, 0.5), "shoulder_y": (0.5, 0.5, 0.5), "shoulder_z": (0.5, 0.5, 0.5),
        "elbow_x": (0.7, MUSCLE_GRADE_3_TORQUE_FRACTION, PASSIVE_TORQUE_FRACTION),
        "forearm_z": (0.5, MUSCLE_GRADE_3_TORQUE_FRACTION, MUSCLE_GRADE_3_TORQUE_FRACTION),
    },
    {},  # C4
)  # fmt: skip
"""Controlled joints of each arm by level of the injury: mobility, then torque shares towards the lower and the upper
joint limit.

The elbow flexes towards its lower limit. Gravity extends it. Shares of the shoulder and all mobilities are assumptions.
"""


def sample_motor_signs(impairment: ImpairmentName, uniforms: FloatArray) -> MotorSigns:
    """Returns sampled motor signs of n people with a clinical impairment.

    ``uniforms`` (n, 1 + 20) are uniform random numbers. If the name of the impairment contains no severity, all
    severities are equally likely.
    """
    name, _, grade = impairment.partition(":")
    severity, grades = uniforms[:, 0], SEVERITIES[name]
    if grade:
        severity = (grades.index(grade) + severity) / len(grades)
    return _SIGNS[name](make_unimpaired_signs(uniforms[:, 1:]), severity)


def _by_joint(share: FloatArray, low_high: tuple[float, float], factors: FloatArray) -> FloatArray:
    """Returns values (n, 20) for all joints: the interpolation between ``low_high`` at ``share`` (n,), multiplied by
    ``factors`` (20,).
    """
    return interpolate(low_high, share)[:, None] * constant_like(factors, share)


def _affected(
    share: FloatArray, low_high: tuple[float, float], joints: FloatArray, other: float
) -> FloatArray:
    """Returns values (n, 20): interpolated between ``low_high`` for the joints of the mask ``joints`` (20,), and
    ``other`` for other joints.
    """
    xp = get_namespace(share)
    return xp.where(constant_like(joints, share), interpolate(low_high, share)[:, None], other)


def _by_part(severity: FloatArray, degrees: Mapping[str, tuple[float, float]]) -> FloatArray:
    """Returns amplitudes (n, 20) of the joints in radians, from the ranges of each body part in degrees."""
    limits = np.radians([degrees.get(joint.body, degrees["arm"]) for joint in JOINTS.values()]).T
    low, high = (constant_like(each, severity) for each in limits)
    return low + (high - low) * severity[:, None]


def _spasticity(signs: MotorSigns, severity: FloatArray) -> MotorSigns:
    elbow = (SPASTIC_RESISTANCE_N_M[0] / STRETCH_SPEED_RAD_S, SPASTIC_RESISTANCE_N_M[1] / STRETCH_SPEED_RAD_S)
    parts = np.array([_STIFFNESS.get(name.split("_")[1], 0.0) for name in JOINTS])
    return replace(
        signs,
        damping_n_m_s=_by_joint(severity, elbow, parts),
        mobility=_affected(severity, SPASTIC_MOBILITY_RANGE, _IN_ARM, 1.0),
        max_speed_rad_s=_affected(severity, AFFECTED_SPEED_LIMIT_RANGE_RAD_S, _IN_ARM, UNLIMITED_SPEED_RAD_S),
    )


def _hemiparesis(signs: MotorSigns, severity: FloatArray, *, side: str) -> MotorSigns:
    joints = np.array([name.startswith(side) for name in JOINTS])
    strength = _affected(severity, PARETIC_STRENGTH, joints, 1.0)
    return replace(
        signs,
        mobility=_affected(severity, PARETIC_MOBILITY, joints, 1.0),
        torque_fraction=strength[..., None] * signs.torque_fraction,
        max_speed_rad_s=_affected(severity, AFFECTED_SPEED_LIMIT_RANGE_RAD_S, joints, UNLIMITED_SPEED_RAD_S),
    )


def _spinal_cord_injury(signs: MotorSigns, severity: FloatArray) -> MotorSigns:
    driven = constant_like(np.array([_driven_joints(level) for level in _SPINAL_LEVELS]), severity)
    shares = driven[choose_index(severity, len(_SPINAL_LEVELS))]
    return replace(signs, mobility=shares[..., 0], torque_fraction=shares[..., 1:])


def _driven_joints(level: Mapping[str, tuple[float, float, float]]) -> FloatArray:
    """Returns mobility and two torque shares of each joint, (20, 3), at a level of spinal cord injury."""
    passive = 0.0, PASSIVE_TORQUE_FRACTION, PASSIVE_TORQUE_FRACTION
    return np.array(
        [
            (1.0, 1.0, 1.0) if joint.body == "head" else level.get(name.partition("_")[2], passive)
            for name, joint in JOINTS.items()
        ]
    )


def _ataxia(signs: MotorSigns, severity: FloatArray) -> MotorSigns:
    return replace(
        signs,
        damping_ratio=_by_joint(severity, ATAXIC_DAMPING_RATIO_RANGE, np.ones(len(JOINTS))),
        intention_tremor_rad=_by_part(severity, INTENTION_TREMOR_AMPLITUDES_DEG),
        tremor_hz=interpolate(INTENTION_TREMOR_RANGE_HZ, signs.oscillation_phase[:, -1]),
    )


def _dyskinesia(signs: MotorSigns, severity: FloatArray) -> MotorSigns:
    return replace(signs, dyskinesia_rad=_by_part(severity, DYSKINESIA_AMPLITUDES_DEG))


_SIGNS: Mapping[ImpairmentName, Callable[[MotorSigns, FloatArray], MotorSigns]] = {
    "spasticity": _spasticity,
    "hemiparesis_left": partial(_hemiparesis, side="left_"),
    "hemiparesis_right": partial(_hemiparesis, side="right_"),
    "spinal_cord_injury": _spinal_cord_injury,
    "ataxia": _ataxia,
    "dyskinesia": _dyskinesia,
}
