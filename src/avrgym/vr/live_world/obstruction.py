"""Detects obstructed parts of the person's body. Contacts prevent such a part from reaching its target.

A contact torque τ displaces a resting servo of stiffness k by τ / k from its target. In free motion, servos also lag,
but with τ = 0. The torque therefore distinguishes obstruction from lag.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.body_names import TRACKED_BODY_PARTS, TrackedBodyPart
from avrgym.models.human import JOINTS
from avrgym.simulation.worlds import Simulation
from avrgym.vr.protocol.messages import Skeleton
from avrgym.vr.tracking.body import ARM_JOINT_INDICES, HEAD_JOINT_INDICES, WAIST_JOINT_INDICES

OBSTRUCTION_START_DISPLACEMENT_M, OBSTRUCTION_END_DISPLACEMENT_M = 0.008, 0.004
"""Displacement by contacts in metres above which a body part becomes obstructed, and below which it becomes free."""
FINGERTIP_DISTANCE_RADII = 4.0
"""Distance of the fingertips from the wrist, in radii of the hand."""


class ObstructionMonitor:
    """Detects obstruction of head, elbows and fingers of the person in the first world."""

    def __init__(self, simulation: Simulation, skeleton: Skeleton) -> None:
        model, bind = simulation.batch.get_model(0), simulation.batch.bind
        names = [human.PERSON_NAME_PREFIX + joint for joint in JOINTS]
        self._joints = np.array([model.joint(name).id for name in names])
        self._dofs = model.jnt_dofadr[self._joints]
        self._stiffness = np.array([float(model.actuator(name).gainprm[0]) for name in names])
        fingers_m = -FINGERTIP_DISTANCE_RADII * skeleton.hand_m
        points = [("head", "head", skeleton.head_centre_m, HEAD_JOINT_INDICES)]
        for side, joints in ARM_JOINT_INDICES.items():
            points += [(side, f"{side}_forearm", 0.0, joints[:3]), (side, f"{side}_hand", fingers_m, joints)]
        self._bodies = np.array([model.body(human.PERSON_NAME_PREFIX + body).id for _, body, _, _ in points])
        self._along_m = np.array([along_m for _, _, along_m, _ in points])
        self._turned_by = np.array(
            [np.isin(np.arange(len(JOINTS)), WAIST_JOINT_INDICES + own) for *_, own in points]
        ).T
        self._of_part = np.array([[part == each for part, *_ in points] for each in TRACKED_BODY_PARTS])
        self._torque, self._axis, self._anchor = bind("qfrc_constraint"), bind("xaxis"), bind("xanchor")
        self._xpos, self._xmat = bind("xpos"), bind("xmat")
        self._obstructed = np.zeros(len(TRACKED_BODY_PARTS), dtype=bool)

    def detect_obstructed_parts(self) -> tuple[TrackedBodyPart, ...]:
        """Returns the body parts that are obstructed after the latest physics step."""
        turns = self._torque[0, self._dofs] / self._stiffness
        if not turns.any():
            self._obstructed[:] = False
            return ()
        displacement_m = (self._of_part * np.linalg.norm(self._displacement_m(turns), axis=-1)).max(axis=-1)
        self._obstructed = displacement_m > np.where(
            self._obstructed, OBSTRUCTION_END_DISPLACEMENT_M, OBSTRUCTION_START_DISPLACEMENT_M
        )
        return tuple(
            part for part, held in zip(TRACKED_BODY_PARTS, self._obstructed.tolist(), strict=True) if held
        )

    def _displacement_m(self, turns: FloatArray) -> FloatArray:
        """Returns the displacement (P, 3) in metres of each point by joint rotations ``turns`` (20,) in radians."""
        axes_w, anchors_w = self._axis[0, self._joints], self._anchor[0, self._joints]
        points_w = self._xpos[0, self._bodies] + self._along_m[:, None] * self._xmat[0, self._bodies, 2::3]
        levers = transforms.cross(axes_w[:, None], points_w - anchors_w[:, None])
        return ((self._turned_by * turns[:, None])[..., None] * levers).sum(axis=0)
