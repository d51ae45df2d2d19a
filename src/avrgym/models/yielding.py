"""What bounds the forces between robot and person: motors of limited torque, and a person who gives way.

MuJoCo's contacts are as stiff as the things that touch are heavy to move. A static person cannot be moved at all,
and neither can a robot's link along its own joint's axis: between those two a contact would have no limit. So a
person's body gives way as flesh and limbs do: by 42 N/mm at the first touch, less and less the deeper it is
pressed. A contact of one point carries at most 100 N at rest, at a depth of 15 mm, whatever presses. ISO/TS 15066 gives
springs of 10 to 150 N/mm for skin and flesh, and 110 to 220 N as what people bear before it hurts: who can, draws
back there.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.models import human, robots
from avrgym.models.robots import Arm

Array = NDArray[np.float64]

STIFFNESS_S2, DAMPING_S = 2770.0, 50.0
"""MuJoCo's acceleration of a contact per metre of depth (1/s²) and per m/s (1/s)."""
IMPEDANCE = (0.98, 0.70)
"""At the first touch, and from ``GIVEN_WAY_M`` on; linear between."""
GIVEN_WAY_M = 0.05
INVERSE_MASS_PER_KG = 3.2
"""What the person's yielding adds to what a contact has to move; the robot's own share makes it softer still."""
PAD_SHARE = 0.3
"""Of the stiffness, for the washcloth, whose low friction makes MuJoCo's contact 20 times as stiff. Measured: at 0.05,
as soft as flesh, the light pad flutters where it is caught between bed and thigh; at 1 it presses twice as hard."""
_ALONE = 1e6
"""Mixed with other geoms' parameters, those of the person count alone."""


def contact_force_n(depth_m: Array) -> Array:
    """What a contact of one point with a person carries at rest, where the robot cannot be moved; any shape."""
    impedance = np.interp(depth_m, [0.0, GIVEN_WAY_M], IMPEDANCE)
    return STIFFNESS_S2 * depth_m * impedance**2 / ((1.0 - impedance) * INVERSE_MASS_PER_KG)


MOST_CONTACT_FORCE_N = float(contact_force_n(np.linspace(0.0, GIVEN_WAY_M, 501)).max())


def bound_forces(spec: mujoco.MjSpec, arm: Arm, lead_rad: float) -> None:
    """Let a scene's person give way to whatever touches them, and an arm's motors press with no more than they aim.

    Args:
        spec: the scene.
        arm: the robot's moving arm.
        lead_rad: how far the target of a servo may run ahead of its joint.
    """
    for geom in spec.geoms:
        if geom.name.startswith(human.PREFIX):
            _soften(geom, 1.0)
        elif geom.name.startswith(robots.PREFIX) and geom.priority:  # tools whose own parameters count alone
            _soften(geom, 1.0 if geom.condim == 1 else PAD_SHARE)
    for joint, torque in zip(arm.joints, torque_limit_n_m(arm, lead_rad), strict=True):
        spec.actuator(robots.PREFIX + joint).forcerange = [-torque, torque]


def torque_limit_n_m(arm: Arm, lead_rad: float) -> Array:
    """What each motor presses with at most, (7,): the spring of its servo at ``lead_rad``, or all that it can."""
    return np.minimum(arm.torque_limit_n_m, lead_rad * arm.stiffness_n_m_rad)


def _soften(geom: mujoco.MjsGeom, share: float) -> None:
    """Set a geom's contact; MuJoCo takes negative numbers as stiffness and damping."""
    last = IMPEDANCE[1]
    geom.solref = [-share * STIFFNESS_S2 * last**2, -DAMPING_S * last]
    geom.solimp = [*IMPEDANCE, GIVEN_WAY_M, 0.5, 1.0]
    geom.solmix = _ALONE
