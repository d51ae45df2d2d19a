"""How each robot's hand holds each tool."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
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


def _three_fingers(*bends_rad: tuple[float, float]) -> dict[str, float]:
    """The Jaco's: how far each finger, the thumb first, and its tip are bent."""
    return {
        f"finger_{part}{number}": bend
        for number, bends in enumerate(bends_rad, start=1)
        for part, bend in zip(("", "tip_"), bends, strict=True)
    }


def _parallel_fingers(opening_rad: float) -> dict[str, float]:
    """The PR2's: two fingers that open alike, their tips parallel."""
    return {
        f"{side}_finger_{part}link": sign * opening_rad
        for side, opened in (("l", 1.0), ("r", -1.0))
        for part, sign in (("", opened), ("tip_", -opened))
    }


GRIPS: Mapping[tuple[str, str], Grip] = {
    ("Jaco", "spoon"): Grip(
        pos=np.zeros(3),
        q=transforms.multiply(
            transforms.from_matrix([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
            transforms.from_axis_angle([1.0, 0.0, 0.0], np.radians(30.0)),
        ),
        finger_angles_rad=_three_fingers((1.40, 0.40), (1.05, 0.35), (1.20, 0.30)),
    ),
    ("Jaco", "cup"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        finger_angles_rad=_three_fingers((0.54, 0.61), (0.38, 0.78), (0.59, 0.50)),
    ),
    ("Jaco", "washcloth"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_angles_rad=_three_fingers((1.40, -0.30), (1.30, -0.20), (1.30, -0.20)),
    ),
    ("Jaco", "scratcher"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        finger_angles_rad=_three_fingers((1.15, 0.30), (1.23, 0.30), (1.23, 0.30)),
    ),
    ("PR2", "spoon"): Grip(
        pos=np.array([0.0, 0.0, -0.0065]),
        q=transforms.IDENTITY_QUATERNION,
        finger_angles_rad=_parallel_fingers(0.051),
    ),
    ("PR2", "cup"): Grip(
        pos=np.zeros(3),
        q=transforms.from_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
        finger_angles_rad=_parallel_fingers(0.48),
    ),
    ("PR2", "washcloth"): Grip(
        pos=np.array([-0.021, 0.0, 0.0]),
        q=transforms.from_matrix([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]),
        finger_angles_rad=_parallel_fingers(0.075),
    ),
    ("PR2", "scratcher"): Grip(
        pos=np.array([-0.020, 0.0, 0.0]),
        q=transforms.IDENTITY_QUATERNION,
        finger_angles_rad=_parallel_fingers(0.066),
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
