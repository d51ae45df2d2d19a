"""What bounds the forces between robot and person: motors of limited torque, and a person who gives way.

Torque alone bounds no force. Close to a joint's axis, along a stretched arm, or where a tool is wedged between arm and
trunk, a motor of 24 N m presses with thousands of newtons on what cannot move, and MuJoCo's contacts are as stiff as
the things that touch are heavy to move. What bounds the force at one point of contact is the person's own give:

- At rest a person is a spring of 25 N/mm at the first touch that gives way ever more: 21 N at 1 mm, 50 N at 4 mm, 68 N
  at 1 cm, and ``MAX_CONTACT_FORCE_N`` at ``MAX_DEPTH_M``. ISO/TS 15066 gives springs of 10 to 150 N/mm for skin and
  flesh, and 110 to 220 N as what people bear before it hurts: who can, draws back long before.
- What strikes adds ``impact_force_n`` at most. With A the inverse mass at the contact and R the contact's own give, it
  is b v / (A + R). What moves with an energy E closes with v ≤ √(2 E A), so that this is at most b √(2 E) / (2 √R), at
  A = R: stiff things cannot close fast. For n contacts at once the same bounds the root of the sum of their squares.
  All joints at full speed hold 0.5 J (Jaco) or 1.1 J (PR2).
- What is being accelerated into a person, by motors or by furniture that it bounces off, adds as much as a strike with
  √(τᵀ M⁻¹ τ) in place of b √(2 E), for the one or two steps until it moves along; τ are the torques on the joints.

The sum over contacts grows with how many points touch. So thin walls of tools count as one shape, see ``tools.Hull``.
Who trembles would press with full strength five times a second, and is held to ``TREMOR_STRENGTH_SHARE`` of it.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import collision_bits, human, robot, tools
from avrgym.models.geoms import add_collision
from avrgym.models.robot import Arm
from avrgym.models.tools import Hull, Tool


@dataclass(frozen=True, kw_only=True)
class ContactCompliance:
    """How a contact gives way: MuJoCo's parameters of it.

    Its impedance falls from ``first`` at the touch to ``last`` at ``depth_m``, along a power of the depth on either
    side of ``midpoint`` (a share of ``depth_m``); see "Impedance" in MuJoCo's documentation of solver parameters.
    """

    stiffness_s2: float
    """Acceleration per metre of depth (1/s²)."""
    damping_s: float
    """Acceleration per m/s (1/s)."""
    first: float
    last: float
    depth_m: float
    midpoint: float = 0.5
    power: float = 1.0

    def impedance(self, depth_m: FloatArray) -> FloatArray:
        """MuJoCo's impedance at a depth, between 0 and 1; any shape."""
        share = np.clip(depth_m / self.depth_m, 0.0, 1.0)
        rising = self.midpoint * (share / self.midpoint) ** self.power
        levelling = 1.0 - (1.0 - self.midpoint) * ((1.0 - share) / (1.0 - self.midpoint)) ** self.power
        return self.first + (self.last - self.first) * np.where(share < self.midpoint, rising, levelling)


SOFT_TISSUE = ContactCompliance(
    stiffness_s2=1700.0, damping_s=50.0, first=0.98, last=0.80, depth_m=0.1, midpoint=0.005, power=3.0
)
WASHCLOTH_PAD = ContactCompliance(stiffness_s2=1400.0, damping_s=25.0, first=0.70, last=0.30, depth_m=0.03)
"""Of the washcloth, whose low friction makes MuJoCo's contact 20 times as stiff: 15 N/mm at the first touch and 70 N
at most. Its own layers are softer by far, so that gentle wiping does not tell."""
INVERSE_MASS_PER_KG = 3.2
"""What the person's yielding adds to what a contact has to move; the robot's own share makes it softer still."""
MAX_DEPTH_M = 0.05
"""Farther in, where only an arm at full speed comes against people who cannot move, the spring grows stiffer again."""
TREMOR_STRENGTH_SHARE = 1 / 3
"""Of their strength, with which people press who tremble: our assumption. It suffices for their tremor, measured
to swing a shoulder by 6° and a head by 17° either way, and for 7° and 20° with all their strength."""
_DOMINANT_MIX = 1e6
"""Mixed with other geoms' parameters, those of the person count alone."""


def contact_force_n(depth_m: FloatArray) -> FloatArray:
    """What a contact of one point with a person carries at rest, where the robot cannot be moved; any shape."""
    impedance = SOFT_TISSUE.impedance(depth_m)
    return SOFT_TISSUE.stiffness_s2 * depth_m * impedance**2 / ((1.0 - impedance) * INVERSE_MASS_PER_KG)


MAX_CONTACT_FORCE_N = float(contact_force_n(np.linspace(0.0, MAX_DEPTH_M, 501)).max())


def impact_force_n(energy_j: FloatArray) -> FloatArray:
    """What the speed of things that move with this energy adds to a contact at most; any shape."""
    give = (1.0 - SOFT_TISSUE.first) / SOFT_TISSUE.first * INVERSE_MASS_PER_KG
    return 0.5 * SOFT_TISSUE.damping_s * np.sqrt(2.0 * energy_j / give)


def limit_contact_forces(spec: mujoco.MjSpec, arm: Arm, tool: Tool, lead_rad: float) -> None:
    """Let a scene's person give way to whatever touches them, and an arm's motors press with no more than they aim.

    Args:
        spec: the scene.
        arm: the robot's moving arm.
        tool: what it holds.
        lead_rad: how far the target of a servo may run ahead of its joint.
    """
    if tool.hull is not None:
        _replace_walls_by_hull(spec, tool.hull)
    for geom in spec.geoms:
        if geom.name.startswith(human.PREFIX):
            set_compliance(geom)
        elif geom.name.startswith(robot.PREFIX) and geom.priority:  # tools whose own parameters count alone
            set_compliance(geom, SOFT_TISSUE if geom.condim == 1 else WASHCLOTH_PAD)
    for joint, torque in zip(arm.joints, torque_limit_n_m(arm, lead_rad), strict=True):
        spec.actuator(robot.PREFIX + joint).forcerange = [-torque, torque]


def set_compliance(geom: mujoco.MjsGeom, give: ContactCompliance = SOFT_TISSUE) -> None:
    """Set a geom's contact; MuJoCo takes negative numbers as stiffness and damping."""
    geom.solref = [-give.stiffness_s2 * give.last**2, -give.damping_s * give.last]
    geom.solimp = [give.first, give.last, give.depth_m, give.midpoint, give.power]
    geom.solmix = _DOMINANT_MIX


def torque_limit_n_m(arm: Arm, lead_rad: float) -> FloatArray:
    """What each motor presses with at most, (J,): the spring of its servo at ``lead_rad``, or all that it can."""
    return np.minimum(arm.torque_limit_n_m, lead_rad * arm.stiffness_n_m_rad)


def person_torque_limit_n_m(strength_n_m: FloatArray, tremor_rad: FloatArray) -> FloatArray:
    """What people's joints press with at most, (N, 20), of what they are able to, who tremble by so much or not."""
    trembling = tremor_rad.any(axis=-1, keepdims=True)
    return np.where(trembling, TREMOR_STRENGTH_SHARE * strength_n_m, strength_n_m)


def _replace_walls_by_hull(spec: mujoco.MjSpec, hull: Hull) -> None:
    """Let people touch a tool's hull in place of its walls."""
    body = spec.body(robot.PREFIX + tools.BODY)
    for name in hull.walls:
        spec.geom(robot.PREFIX + name).conaffinity = 0
    add_collision(
        body, robot.PREFIX + "hull", hull.shape, collision_bits.HULL, pos=hull.pos, size=hull.size, mass=0.0
    )
