"""Which parts of a person something is in the way of: contacts keep them from where their servos aim.

At rest a servo of stiffness k holds its joint τ / k from its aim where contacts press with a torque τ. In free movement
servos lag behind too, but τ is zero: so what is in the way is told from what is only late.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.models import human
from avrgym.models.body_names import PARTS, Part
from avrgym.models.human import JOINTS
from avrgym.simulation.worlds import Simulation
from avrgym.vr.protocol.messages import Skeleton
from avrgym.vr.tracking.body import ARMS, HEAD, WAIST

HELD_M, FREE_M = 0.008, 0.004
"""A part that is moved so far out of its way is held back, until it is nearer than the other."""
FINGERS = 4.0
"""The fingers' ends are about so many of the hand's radii from the wrist."""


class HeldBack:
    """Watches head, elbows and fingers of the first world's person, who has this skeleton."""

    def __init__(self, simulation: Simulation, skeleton: Skeleton) -> None:
        model, bind = simulation.batch.get_model(0), simulation.batch.bind
        names = [human.PREFIX + joint for joint in JOINTS]
        self._joints = np.array([model.joint(name).id for name in names])
        self._dofs = model.jnt_dofadr[self._joints]
        self._stiffness = np.array([float(model.actuator(name).gainprm[0]) for name in names])
        fingers_m = -FINGERS * skeleton.hand_m
        points = [("head", "head", skeleton.head_centre_m, HEAD)]
        for side, joints in ARMS.items():
            points += [(side, f"{side}_forearm", 0.0, joints[:3]), (side, f"{side}_hand", fingers_m, joints)]
        self._bodies = np.array([model.body(human.PREFIX + body).id for _, body, _, _ in points])
        self._along_m = np.array([along_m for _, _, along_m, _ in points])
        self._turned_by = np.array([np.isin(np.arange(len(JOINTS)), WAIST + own) for *_, own in points]).T
        self._of_part = np.array([[part == each for part, *_ in points] for each in PARTS])
        self._torque, self._axis, self._anchor = bind("qfrc_constraint"), bind("xaxis"), bind("xanchor")
        self._xpos, self._xmat = bind("xpos"), bind("xmat")
        self._held = np.zeros(len(PARTS), dtype=bool)

    def now(self) -> tuple[Part, ...]:
        """The parts that the latest physics step held back."""
        moved_m = (self._of_part * np.linalg.norm(self._moved(), axis=-1)).max(axis=-1)
        self._held = moved_m > np.where(self._held, FREE_M, HELD_M)
        return tuple(part for part, held in zip(PARTS, self._held.tolist(), strict=True) if held)

    def _moved(self) -> FloatArray:
        """By how much contacts move each point (P, 3), metres: of each joint the turn times the point's lever."""
        turns = self._torque[0, self._dofs] / self._stiffness
        axes_w, anchors_w = self._axis[0, self._joints], self._anchor[0, self._joints]
        points_w = self._xpos[0, self._bodies] + self._along_m[:, None] * self._xmat[0, self._bodies, 2::3]
        levers = np.cross(axes_w[:, None], points_w - anchors_w[:, None])
        return ((self._turned_by * turns[:, None])[..., None] * levers).sum(axis=0)
