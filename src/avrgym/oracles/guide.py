"""Leading a tool through space: from where it should go to actions of the arm."""

import numpy as np
from numpy.typing import NDArray

from avrgym import kinematics, transforms
from avrgym.episodes import Episodes
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.tasks import places

Array = NDArray[np.float64]

ITERATIONS = 8


class Guide:
    """Inverse kinematics of the moving arms of N worlds, from one control step to the next.

    It remembers the angles that it has asked for, so that the servos' lag does not slow the tool down.
    """

    def __init__(self, episodes: Episodes) -> None:
        self._episodes = episodes
        self._chain = places.arm_chain(episodes.stage)
        self._limit = episodes.stage.arm.speed_limit_rad_s
        state = episodes.simulation.state()
        self._asked_rad = state.arm_angles_rad
        self.pos_w, self.q_w = state.tool_pos_w, state.tool_q_w

    def toward(self, target_pos_w: Array, target_q_w: Array, speed_m_s: Array, turn_rad_s: float) -> Array:
        """Actions (N, 7) that bring the tool nearer to its target along a straight line.

        ``target_pos_w`` (N, 3) and ``target_q_w`` (N, 4); the tool moves and turns no faster than given, and as
        fast as the arm's joints allow.
        """
        step = target_pos_w - self.pos_w
        length = np.sqrt((step * step).sum(axis=-1))
        share = np.minimum(1.0, CONTROL_STEP_S * speed_m_s / np.maximum(length, 1e-9))
        turn = transforms.to_rotation_vector(transforms.multiply(target_q_w, transforms.conjugate(self.q_w)))
        angle = np.sqrt((turn * turn).sum(axis=-1))
        turn_share = np.minimum(1.0, CONTROL_STEP_S * turn_rad_s / np.maximum(angle, 1e-9))
        pos_w = self.pos_w + share[:, None] * step
        q_w = transforms.multiply(transforms.from_rotation_vector(turn_share[:, None] * turn), self.q_w)
        return self._ask(pos_w, q_w)

    def _ask(self, pos_w: Array, q_w: Array) -> Array:
        base_pos, base_q = self._episodes.simulation.robot_base()
        to_base = transforms.invert(base_pos, base_q)
        pos, q = transforms.compose(*to_base, pos_w, q_w)
        angles = kinematics.solve(self._chain, pos, q, self._asked_rad, iterations=ITERATIONS).angles_rad
        reach = self._limit * CONTROL_STEP_S
        step = angles - self._asked_rad
        step /= np.maximum(1.0, np.abs(step / reach).max(axis=-1, keepdims=True))
        self._asked_rad = self._asked_rad + step
        pos, q = kinematics.forward(self._chain, self._asked_rad)
        self.pos_w, self.q_w = transforms.compose(base_pos, base_q, pos, q)
        return step / reach
