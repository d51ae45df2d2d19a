"""Compliance of contacts with the person, and torque limits. Both together bound the contact forces.

Torque limits alone do not bound contact forces. Near a joint's axis or along a stretched arm, a small torque can cause
a force of thousands of newtons. The stiffness of MuJoCo's contacts increases with the mass of the bodies. A compliant
body of the person therefore bounds the force at each contact point:

- At rest the person is a softening spring. Its stiffness at first touch is 25 N/mm. The force is 21 N at 1 mm, 50 N at
  4 mm, 68 N at 1 cm, and ``MAX_CONTACT_FORCE_N`` at ``MAX_CONTACT_DEPTH_M``. For comparison, ISO/TS 15066 has springs
  of 10 to 150 N/mm and pain limits of 110 to 220 N.
- An impact adds at most ``compute_impact_force_n``. With inverse mass A at the contact and compliance R of the
  contact, the additional force is b v / (A + R). Bodies with energy E approach with v ≤ √(2 E A). The maximum is
  therefore b √(2 E) / (2 √R), at A = R. For n contacts, the same value bounds the root of the sum of squares. All
  joints at full speed have 0.5 J (Jaco) or 1.1 J (PR2).
- Motors can accelerate bodies into the person, and furniture can reflect bodies. For one or two steps, this adds the
  force of an impact with √(τᵀ M⁻¹ τ) in place of b √(2 E); τ are the joint torques.

The sum of forces grows with the number of contact points. One collision shape therefore replaces the thin walls of a
tool, see ``tools.CollisionHull``. People with tremor use only ``TREMOR_STRENGTH_FRACTION`` of their strength.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.kinematics import compute_joint_scales
from avrgym.models import collision_bits, human, robot, tools
from avrgym.models.geoms import add_collision_geom
from avrgym.models.robot import Arm
from avrgym.models.tools import CollisionHull, Tool


@dataclass(frozen=True, kw_only=True)
class ContactCompliance:
    """MuJoCo's parameters of a compliant contact.

    The impedance decreases from ``impedance_start`` at first touch to ``impedance_end`` at depth ``impedance_width_m``.
    The transition is a power law on both sides of ``impedance_midpoint`` (a share of the width). See "Impedance" under
    "Solver parameters" in MuJoCo's documentation.
    """

    stiffness_per_s2: float
    """Stiffness of the contact: acceleration per penetration depth (1/s²)."""
    damping_per_s: float
    """Damping of the contact: acceleration per penetration speed (1/s)."""
    impedance_start: float
    impedance_end: float
    impedance_width_m: float
    impedance_midpoint: float = 0.5
    impedance_power: float = 1.0

    def compute_impedance(self, depth_m: FloatArray) -> FloatArray:
        """Returns MuJoCo's contact impedance, 0 to 1, for penetration depths of any array shape."""
        share = np.clip(depth_m / self.impedance_width_m, 0.0, 1.0)
        rising = self.impedance_midpoint * (share / self.impedance_midpoint) ** self.impedance_power
        levelling = (
            1.0
            - (1.0 - self.impedance_midpoint)
            * ((1.0 - share) / (1.0 - self.impedance_midpoint)) ** self.impedance_power
        )
        return self.impedance_start + (self.impedance_end - self.impedance_start) * np.where(
            share < self.impedance_midpoint, rising, levelling
        )


SOFT_TISSUE = ContactCompliance(
    stiffness_per_s2=1700.0,
    damping_per_s=50.0,
    impedance_start=0.98,
    impedance_end=0.80,
    impedance_width_m=0.1,
    impedance_midpoint=0.005,
    impedance_power=3.0,
)
WASHCLOTH_PAD = ContactCompliance(
    stiffness_per_s2=1400.0,
    damping_per_s=25.0,
    impedance_start=0.70,
    impedance_end=0.30,
    impedance_width_m=0.03,
)
"""Contact parameters of the washcloth's pad. The friction of the pad is low, which makes MuJoCo's contact 20 times
stiffer: 15 N/mm at first touch and 70 N at most. The springs of the washcloth are much softer.
"""
PERSON_INVERSE_MASS_PER_KG = 3.2
"""Inverse mass of the person's body at a contact, 1/kg. The inverse mass of the robot increases the compliance further.
"""
MAX_CONTACT_DEPTH_M = 0.05
"""Maximum penetration depth of the softening spring; at larger depths it becomes stiffer. Only an arm at full speed
against a fixed person reaches this depth."""
TREMOR_STRENGTH_FRACTION = 1 / 3
"""Share of their strength that people with tremor use (assumption). The reduced strength decreases the tremor only
slightly.
"""
_DOMINANT_MIX = 1e6
"""MuJoCo's ``solmix`` of a geom that determines the contact parameters."""


def compute_contact_force_n(depth_m: FloatArray) -> FloatArray:
    """Returns the static forces of a one-point contact with the person, for penetration depths of any array shape.

    The robot is fixed in this model.
    """
    impedance = SOFT_TISSUE.compute_impedance(depth_m)
    return (
        SOFT_TISSUE.stiffness_per_s2
        * depth_m
        * impedance**2
        / ((1.0 - impedance) * PERSON_INVERSE_MASS_PER_KG)
    )


MAX_CONTACT_FORCE_N = float(compute_contact_force_n(np.linspace(0.0, MAX_CONTACT_DEPTH_M, 501)).max())


def compute_impact_force_n(energy_j: FloatArray) -> FloatArray:
    """Returns the maximum additional forces of impacts, for kinetic energies of any array shape."""
    compliance = (
        (1.0 - SOFT_TISSUE.impedance_start) / SOFT_TISSUE.impedance_start * PERSON_INVERSE_MASS_PER_KG
    )
    return 0.5 * SOFT_TISSUE.damping_per_s * np.sqrt(2.0 * energy_j / compliance)


def limit_contact_forces(spec: mujoco.MjSpec, arm: Arm, tool: Tool, lead_rad: float) -> None:
    """Make all contacts with the person compliant, and limit the torques of the arm.

    Args:
        spec: model of the scene, which is changed.
        arm: moving arm of the scene's robot.
        tool: the tool in the hand of this arm.
        lead_rad: maximum distance between servo target and joint position, in ``kinematics.compute_joint_scales``.
    """
    if tool.hull is not None:
        _replace_walls_by_hull(spec, tool.hull)
    for geom in spec.geoms:
        if geom.name.startswith(human.PERSON_NAME_PREFIX):
            set_compliance(geom)
        elif (
            geom.name.startswith(robot.ROBOT_NAME_PREFIX) and geom.priority
        ):  # MuJoCo uses the contact parameters of these tools
            set_compliance(geom, SOFT_TISSUE if geom.condim == 1 else WASHCLOTH_PAD)
    lead = lead_rad * compute_joint_scales(
        [spec.joint(robot.ROBOT_NAME_PREFIX + joint).type for joint in arm.joints]
    )
    for joint, effort in zip(arm.joints, compute_effective_effort_limits(arm, lead), strict=True):
        spec.actuator(robot.ROBOT_NAME_PREFIX + joint).forcerange = [-effort, effort]


def set_compliance(geom: mujoco.MjsGeom, compliance: ContactCompliance = SOFT_TISSUE) -> None:
    """Set a geom's contact parameters. Negative ``solref`` values mean stiffness and damping in MuJoCo."""
    geom.solref = [
        -compliance.stiffness_per_s2 * compliance.impedance_end**2,
        -compliance.damping_per_s * compliance.impedance_end,
    ]
    geom.solimp = [
        compliance.impedance_start,
        compliance.impedance_end,
        compliance.impedance_width_m,
        compliance.impedance_midpoint,
        compliance.impedance_power,
    ]
    geom.solmix = _DOMINANT_MIX


def compute_effective_effort_limits(arm: Arm, lead: FloatArray | float) -> FloatArray:
    """Returns limits of torque or force (J,): the motor's limit, or the servo's spring force if this is lower.

    ``lead`` is the maximum distance between servo target and joint position.
    """
    return np.minimum(arm.effort_limit, lead * arm.stiffness)


def compute_person_torque_limits_n_m(strength_n_m: FloatArray, tremor_rad: FloatArray) -> FloatArray:
    """Returns the torque limits (N, 20) of people's joints in N·m. They are reduced for people with tremor."""
    trembling = tremor_rad.any(axis=-1, keepdims=True)
    return np.where(trembling, TREMOR_STRENGTH_FRACTION * strength_n_m, strength_n_m)


def _replace_walls_by_hull(spec: mujoco.MjSpec, hull: CollisionHull) -> None:
    """Make people collide with a tool's hull instead of its walls."""
    body = spec.body(robot.ROBOT_NAME_PREFIX + tools.TOOL_BODY)
    for name in hull.replaced_geoms:
        spec.geom(robot.ROBOT_NAME_PREFIX + name).conaffinity = 0
    add_collision_geom(
        body,
        robot.ROBOT_NAME_PREFIX + "hull",
        hull.shape,
        collision_bits.HULL,
        pos=hull.pos,
        size=hull.size,
        mass=0.0,
    )
