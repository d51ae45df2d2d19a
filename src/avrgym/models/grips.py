"""How each robot's hand holds each tool."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym import transforms
from avrgym.models.robots import Arm, Robot, turn_body
from avrgym.models.tools import Tool

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Grip:
    """Where the hand holds a tool.

    ``pos`` (3,), metres, and ``q`` (4,) place the tool's frame, moved to its ``grip_pos``, in the end effector's
    frame. ``finger_angles_rad`` turn bodies of the fingers, named without the arm's prefix, about their z.
    """

    pos: Array
    q: Array
    finger_angles_rad: Mapping[str, float]


GRIPS: Mapping[tuple[str, str], Grip] = {
    ("Jaco", "spoon"): Grip(
        pos=np.zeros(3),
        q=transforms.multiply(
            transforms.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0)),
        ),
        finger_angles_rad={
            "finger_1": 1.40,
            "finger_tip_1": 0.40,
            "finger_2": 1.05,
            "finger_tip_2": 0.35,
            "finger_3": 1.20,
            "finger_tip_3": 0.30,
        },
    ),
    ("Jaco", "cup"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        finger_angles_rad={
            "finger_1": 0.54,
            "finger_tip_1": 0.61,
            "finger_2": 0.38,
            "finger_tip_2": 0.78,
            "finger_3": 0.59,
            "finger_tip_3": 0.50,
        },
    ),
    ("Jaco", "washcloth"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_angles_rad={
            "finger_1": 1.40,
            "finger_tip_1": -0.30,
            "finger_2": 1.30,
            "finger_tip_2": -0.20,
            "finger_3": 1.30,
            "finger_tip_3": -0.20,
        },
    ),
    ("Jaco", "scratcher"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_angles_rad={
            "finger_1": 1.15,
            "finger_tip_1": 0.30,
            "finger_2": 1.23,
            "finger_tip_2": 0.30,
            "finger_3": 1.23,
            "finger_tip_3": 0.30,
        },
    ),
    ("PR2", "spoon"): Grip(
        pos=np.array([0.0, 0.0, -0.0065]),
        q=transforms.IDENTITY_QUATERNION,
        finger_angles_rad={
            "l_finger_link": 0.051,
            "l_finger_tip_link": -0.051,
            "r_finger_link": -0.051,
            "r_finger_tip_link": 0.051,
        },
    ),
    ("PR2", "cup"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        finger_angles_rad={
            "l_finger_link": 0.48,
            "l_finger_tip_link": -0.48,
            "r_finger_link": -0.48,
            "r_finger_tip_link": 0.48,
        },
    ),
    ("PR2", "washcloth"): Grip(
        pos=np.array([-0.021, 0.0, 0.0]),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        finger_angles_rad={
            "l_finger_link": 0.075,
            "l_finger_tip_link": -0.075,
            "r_finger_link": -0.075,
            "r_finger_tip_link": 0.075,
        },
    ),
    ("PR2", "scratcher"): Grip(
        pos=np.array([-0.020, 0.0, 0.0]),
        q=transforms.IDENTITY_QUATERNION,
        finger_angles_rad={
            "l_finger_link": 0.066,
            "l_finger_tip_link": -0.066,
            "r_finger_link": -0.066,
            "r_finger_tip_link": 0.066,
        },
    ),
}
"""By the names of robot and tool. Fingertips touch what they hold, within 3 mm."""


def hold(spec: mujoco.MjSpec, robot: Robot, arm: Arm, tool: Tool, name: str) -> mujoco.MjsBody:
    """Close the fingers and add the tool's empty body to the hand; give that body."""
    grip = GRIPS[robot.name, tool.name]
    for finger, angle in grip.finger_angles_rad.items():
        turn_body(spec, arm.finger_prefix + finger, [0.0, 0.0, 1.0], angle)
    return spec.body(arm.end_effector).add_body(
        name=name,
        pos=grip.pos - transforms.rotate(grip.q, tool.grip_pos),
        quat=grip.q,
        gravcomp=1.0,
    )
