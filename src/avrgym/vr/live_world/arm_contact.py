"""Detects contacts with a participant's arms, for haptic feedback."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.models import human, robot
from avrgym.simulation.worlds import Simulation

ARM_SEGMENT_NAMES = ("upper_arm", "forearm", "hand")


class ArmContactMonitor:
    """Detects contacts of robot and tool with the left and right arm of the person in the first world."""

    def __init__(self, simulation: Simulation) -> None:
        model = simulation.batch.get_model(0)
        bodies = [model.body(int(body)).name for body in model.geom_bodyid]
        self._batch, self._data = simulation.batch, mujoco.MjData(model)
        self._is_robot = np.array([name.startswith(robot.ROBOT_NAME_PREFIX) for name in bodies])
        self._is_arm = {
            side: np.isin(bodies, [f"{human.PERSON_NAME_PREFIX}{side}_{part}" for part in ARM_SEGMENT_NAMES])
            for side in ("left", "right")
        }

    def detect_touched_arms(self) -> tuple[bool, bool]:
        """Returns (left, right): whether robot or tool touches this arm or its hand."""
        geoms = self._batch.get_data(0, self._data).contact.geom
        return self._touches("left", geoms), self._touches("right", geoms)

    def _touches(self, side: str, geoms: NDArray[np.int32]) -> bool:
        arm, robot = self._is_arm[side][geoms], self._is_robot[geoms]
        return bool((arm & robot[:, ::-1]).any())
