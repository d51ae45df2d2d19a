"""Leading a tool through space: from where it should go to actions of the arm."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.experts.robot_clearance import Clearance
from avrgym.tasks.task import RunningEpisodes

ITERATIONS = 8
POSTURE_SHARE = 0.1
"""How much of the way to its posture the arm goes in a control step, where the tool leaves it free to."""

STARTS, SPREAD_RAD = 12, 1.5
"""From how many poses the search for angles begins: where the arm is, and others around it."""
CONSIDERED = 8
"""How many of the angles found for a pose are looked at more closely."""
PARTS_OF_THE_WAY = (0.2, 0.4, 0.6, 0.8, 1.0)
BLOCKED_S, TILTED_S_RAD, MARGIN_M = 20.0, 20.0, 0.03
"""What it costs when the arm would touch something or tilt its tool, and how far from a touch that begins."""
ACCURACY_M, ACCURACY_RAD = 0.003, 0.03
UP = (0.0, 0.0, 1.0)


class MotionPlanner:
    """The moving arms of N worlds and the angles they are asked for, from one control step to the next.

    What is asked for goes on from where the servos aim, so that their lag does not slow the tool down. ``pos_w``
    (N, 3) and ``q_w`` (N, 4) are the tool's pose at these angles. ``posture_rad`` (N, J), the arm's first angles
    until an expert sets others, draws the arm wherever the tool leaves it free. ``scene`` is what stands around.
    """

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Begin where the arms are."""
        self._episodes, self._simulation = episodes, episodes.simulation
        self.scene = episodes.scene
        self._chain = placement.arm_chain(self.scene)
        self._reach_rad = self.scene.arm.speed_limit_rad_s * CONTROL_STEP_S
        self._clearance = Clearance(self._simulation)
        self._base_w = self._simulation.robot_base()
        self._to_base = transforms.invert(*self._base_w)
        self._put(self._simulation.arm_angles_rad())
        self.posture_rad = self.angles_rad

    def toward(
        self,
        target_pos_w: FloatArray,
        target_q_w: FloatArray,
        speed_m_s: FloatArray | float,
        turn_rad_s: float,
    ) -> FloatArray:
        """Actions (N, J) that bring the tool nearer to its target along a straight line.

        ``target_pos_w`` (N, 3) and ``target_q_w`` (N, 4); the tool moves and turns no faster than given, and as
        fast as the arm's joints allow.
        """
        return self.ask(self.straight(target_pos_w, target_q_w, speed_m_s, turn_rad_s))

    def straight(
        self,
        target_pos_w: FloatArray,
        target_q_w: FloatArray,
        speed_m_s: FloatArray | float,
        turn_rad_s: float,
    ) -> FloatArray:
        """The angles (N, J) of the next pose on the straight line to a target; see ``toward``."""
        self._see()
        step = target_pos_w - self.pos_w
        turn = transforms.to_rotation_vector(transforms.multiply(target_q_w, transforms.conjugate(self.q_w)))
        step = step * _share(step, CONTROL_STEP_S * speed_m_s)
        turn = turn * _share(turn, CONTROL_STEP_S * turn_rad_s)
        q_w = transforms.multiply(transforms.from_rotation_vector(turn), self.q_w)
        pull = POSTURE_SHARE * (self.posture_rad - self.angles_rad)
        pull *= _share(pull, np.full(len(pull), POSTURE_SHARE))
        return self.angles_at(self.pos_w + step, q_w, self.angles_rad + pull)

    def swing(self, target_rad: FloatArray, speed_m_s: FloatArray | float, tilt_rad: float) -> FloatArray:
        """The angles (N, J) of the next pose on the way to others, all joints together.

        The tool moves no faster than given, and its z axis stays within ``tilt_rad`` of the vertical.
        """
        self._see()
        step = self._within_limits(target_rad - self.angles_rad)
        pos, _ = self.pose(self.angles_rad + step)
        step *= _share(pos - self.pos_w, CONTROL_STEP_S * speed_m_s)
        pos_w, q_w = self.pose(self.angles_rad + step)
        return self.angles_at(pos_w, _upright(q_w, tilt_rad), self.angles_rad + step)

    def ask(self, angles_rad: FloatArray) -> FloatArray:
        """Actions (N, J) that bring the arms towards angles (N, J), all joints together, within their limits."""
        self._see()
        step = self._within_limits(angles_rad - self.angles_rad)
        self._put(self.angles_rad + step)
        return step / self._reach_rad

    def find(
        self, pos_w: FloatArray, q_w: FloatArray, tilt_rad: float = np.pi
    ) -> tuple[FloatArray, FloatArray]:
        """Angles (N, K, J) for K tool poses per world, (N, K, 3) and (N, K, 4): near, and clear of all else.

        Returns:
            The angles, and what they cost, (N, K): how many seconds a swing there takes at least, and
            ``BLOCKED_S`` or more where arm or tool would touch person or furniture on the way, the arm also at its
            end, and ``TILTED_S_RAD`` for each radian that the tool would tilt more than it may; infinite where no
            angles were found.
        """
        worlds, poses = q_w.shape[:2]
        to_base_pos, to_base_q = (part[:, None] for part in self._to_base)
        pos, q = transforms.compose(to_base_pos, to_base_q, pos_w, q_w)
        joints = self.angles_rad.shape[-1]
        starts = self.angles_rad[:, None, None] + _around(joints)
        starts = np.tile(starts, (1, poses, 1, 1)).reshape(-1, joints)
        pos, q = (np.repeat(part.reshape(worlds * poses, -1), STARTS, axis=0) for part in (pos, q))
        solution = kinematics.solve(self._chain, pos, q, starts)
        angles = self._unwound(solution.angles_rad.reshape(worlds, -1, joints))
        missed = (solution.position_error_m > ACCURACY_M) | (solution.rotation_error_rad > ACCURACY_RAD)
        cost = np.where(missed.reshape(worlds, -1), np.inf, self._cost_level_s(angles, tilt_rad))
        cost, angles = _least(
            cost.reshape(worlds, poses, -1), angles.reshape(worlds, poses, -1, joints), CONSIDERED
        )
        cost += self._cost_clear_s(angles.reshape(worlds, -1, joints)).reshape(cost.shape)
        cost, angles = _least(cost, angles, 1)
        return angles[:, :, 0], cost[:, :, 0]

    def _cost_level_s(self, angles_rad: FloatArray, tilt_rad: float) -> FloatArray:
        """How long swings to angles (N, M, J) take at least, and what it costs that they tilt the tool, (N, M)."""
        way = angles_rad - self.angles_rad[:, None]
        tilt = [self._tilt_rad(self.angles_rad[:, None] + share * way) for share in PARTS_OF_THE_WAY]
        excess = np.maximum(0.0, np.max(tilt, axis=0) - tilt_rad)
        return CONTROL_STEP_S * np.abs(way / self._reach_rad).max(axis=-1) + TILTED_S_RAD * excess

    def _cost_clear_s(self, angles_rad: FloatArray) -> FloatArray:
        """What it costs that swings to angles (N, M, J) come close to something, (N, M)."""
        way = angles_rad - self.angles_rad[:, None]
        state, gap = self._episodes.state(), np.full(way.shape[:2], np.inf)
        for share in PARTS_OF_THE_WAY:
            there = self.angles_rad[:, None] + share * way
            gap = np.minimum(gap, self._clearance.least_m(there, state, tool=share < 1.0))
        return BLOCKED_S * np.maximum(0.0, 1.0 - gap / MARGIN_M)

    def _tilt_rad(self, angles_rad: FloatArray) -> FloatArray:
        """How far (N, M) the tool's z axis is from the vertical at angles (N, M, J)."""
        _, q = kinematics.forward(self._chain, angles_rad.reshape(-1, angles_rad.shape[-1]))
        z_w = transforms.rotate(
            self._base_w[1][:, None], transforms.rotate(q, UP).reshape(*angles_rad.shape[:2], 3)
        )
        return elementary.arccos(np.clip(z_w[..., 2], -1.0, 1.0))

    def angles_at(self, pos_w: FloatArray, q_w: FloatArray, near_rad: FloatArray) -> FloatArray:
        """Angles (N, J) for a tool pose not far from that of other angles."""
        pos, q = transforms.compose(*self._to_base, pos_w, q_w)
        return kinematics.solve(self._chain, pos, q, near_rad, iterations=ITERATIONS).angles_rad

    def pose(self, angles_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The tool's positions (N, 3) and rotations (N, 4) at angles (N, J), world frame."""
        return transforms.compose(*self._base_w, *kinematics.forward(self._chain, angles_rad))

    def _unwound(self, angles_rad: FloatArray) -> FloatArray:
        """The same angles (N, M, J) plus whole turns, as near to where the arm is as their ranges allow."""
        turns = np.round((self.angles_rad[:, None] - angles_rad) / (2.0 * np.pi))
        turned = angles_rad + 2.0 * np.pi * turns
        inside = (turned >= self._chain.lower_rad) & (turned <= self._chain.upper_rad)
        return np.where(inside, turned, angles_rad)

    def _see(self) -> None:
        """Go on from where the servos aim, whoever has asked them to."""
        self._put(self._simulation.arm_targets_rad())

    def _put(self, angles_rad: FloatArray) -> None:
        self.angles_rad = angles_rad
        self.pos_w, self.q_w = self.pose(angles_rad)

    def _within_limits(self, step_rad: FloatArray) -> FloatArray:
        return step_rad / np.maximum(1.0, np.abs(step_rad / self._reach_rad).max(axis=-1, keepdims=True))


def _around(joints: int) -> FloatArray:
    """Where the search begins, ``STARTS`` rows (…, J): radians from where the arm is."""
    others = random_streams.planner_starts().uniform(-SPREAD_RAD, SPREAD_RAD, (STARTS - 1, joints))
    return np.concatenate([np.zeros((1, joints)), others])


def _least(cost: FloatArray, angles_rad: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """The cheapest of costs (N, K, R) and their angles (N, K, R, J), as many as ``count``, the best first."""
    best = np.argsort(cost, axis=-1, kind="stable")[..., :count]
    return np.take_along_axis(cost, best, axis=-1), np.take_along_axis(angles_rad, best[..., None], axis=2)


def _share(step: FloatArray, longest: FloatArray | float) -> FloatArray:
    """What share (N, 1) of steps (N, k) keeps them no longer than (N,)."""
    length = transforms.norm(step)
    return np.minimum(1.0, longest / np.maximum(length, 1e-9))[:, None]


def _upright(q_w: FloatArray, tilt_rad: float) -> FloatArray:
    """Rotations (N, 4) turned back, the shortest way, to where their z axis is within a tilt of the vertical."""
    z_w = transforms.rotate(q_w, UP)
    axis = transforms.cross(z_w, UP)
    sine = transforms.norm(axis)
    excess = np.maximum(0.0, elementary.arctan2(sine, z_w[:, 2]) - tilt_rad)
    back = axis * (excess / np.maximum(sine, 1e-9))[:, None]
    return transforms.multiply(transforms.from_rotation_vector(back), q_w)
