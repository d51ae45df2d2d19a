"""Motion planning for experts: computes actions from tool targets, by inverse kinematics."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.simulation.worlds import State
from avrgym.system import random_streams
from avrgym.tasks import placement
from avrgym.tasks.robot_clearance import RobotClearance
from avrgym.tasks.task import RunningEpisodes

IK_ITERATIONS = 8
POSTURE_STEP_FRACTION = 0.1
"""Share of the joint distance to the preferred posture that the arm covers in one control step."""

NUM_IK_STARTS, MAX_IK_START_OFFSET_RAD = 12, 1.5
"""Number of start poses of the inverse kinematics, and maximum offset of each joint from the current pose.

The first start pose is the current pose. The others are random poses around it.
"""
CHECKED_IK_SOLUTIONS = 8
"""Number of solutions for each tool pose that are checked for collisions."""
CHECKED_PATH_FRACTIONS = (0.2, 0.4, 0.6, 0.8, 1.0)
COLLISION_COST_S, TILT_COST_S_PER_RAD, COLLISION_MARGIN_M = 20.0, 20.0, 0.03
"""Cost of a collision in seconds, and cost of tool tilt in seconds per radian. The collision cost begins at the
distance ``COLLISION_MARGIN_M``.
"""
MAX_POSITION_ERROR_M, MAX_ROTATION_ERROR_RAD = 0.003, 0.03
YAW_GAIN_PER_S = 2.0
"""Turn rate of a driving base per radian of deviation from its initial yaw, 1/s."""
UP = (0.0, 0.0, 1.0)


class MotionPlanner:
    """Plans the motion of the robots' arms in N worlds, one control step at a time.

    Plans continue from the servo targets. The lag of the servos therefore does not slow the tool down. For a driving
    robot, the first of the J joints is the travel of its base, see ``placement.make_planning_chain``.

    Attributes:
        joint_positions: planned joint positions (N, J).
        tool_pos_w, tool_quat_w: tool pose at these positions, (N, 3) and (N, 4).
        preferred_posture: preferred posture (N, J), initially the start positions. It determines the motion in the
            arm's null space.
        scene: the scene of all worlds.
    """

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Start with the current joint positions of the robots."""
        self._episodes, self._simulation = episodes, episodes.simulation
        self.scene = episodes.scene
        self._chain = placement.make_planning_chain(self.scene)
        self._step_s = self.scene.control_step_s
        self._drive = drive = self.scene.robot.drive
        travel = () if drive is None else (drive.speed_limit_m_s,)
        self._reach = np.concatenate([travel, self.scene.arm.speed_limit]) * self._step_s
        self._base_w = self._simulation.get_initial_base_pose()
        self._clearance = RobotClearance(self.scene, self._chain, *self._base_w)
        self._to_base = transforms.invert(*self._base_w)
        self._continue_from(self._simulation.get_joint_positions())
        self.preferred_posture = self.joint_positions

    def compute_action_to_pose(
        self,
        target_pos_w: FloatArray,
        target_q_w: FloatArray,
        speed_m_s: FloatArray | float,
        turn_rad_s: float,
    ) -> FloatArray:
        """Returns actions (N, A) that move the tool on a straight line to the target pose, (N, 3) and (N, 4).

        The tool moves as fast as the joints allow, up to the given speeds.
        """
        return self.compute_action_to_joint_positions(
            self.plan_straight_line_step(target_pos_w, target_q_w, speed_m_s, turn_rad_s)
        )

    def plan_straight_line_step(
        self,
        target_pos_w: FloatArray,
        target_q_w: FloatArray,
        speed_m_s: FloatArray | float,
        turn_rad_s: float,
    ) -> FloatArray:
        """Returns joint positions (N, J) of the next pose on a straight line to the target, see
        ``compute_action_to_pose``.
        """
        self._update()
        step = target_pos_w - self.tool_pos_w
        turn = transforms.to_rotation_vector(
            transforms.multiply(target_q_w, transforms.conjugate(self.tool_quat_w))
        )
        step = step * _limiting_share(step, self._step_s * speed_m_s)
        turn = turn * _limiting_share(turn, self._step_s * turn_rad_s)
        q_w = transforms.multiply(transforms.from_rotation_vector(turn), self.tool_quat_w)
        pull = POSTURE_STEP_FRACTION * (self.preferred_posture - self.joint_positions)
        pull *= _limiting_share(pull / self._chain.joint_scales, np.full(len(pull), POSTURE_STEP_FRACTION))
        return self.solve_inverse_kinematics(self.tool_pos_w + step, q_w, self.joint_positions + pull)

    def plan_joint_space_step(
        self, target: FloatArray, speed_m_s: FloatArray | float, tilt_rad: float
    ) -> FloatArray:
        """Returns joint positions (N, J) of the next step towards a target (N, J). All joints move in proportion.

        The tool moves at up to ``speed_m_s``. Its z axis stays within ``tilt_rad`` of the vertical.
        """
        self._update()
        step = self._within_limits(target - self.joint_positions)
        pos, _ = self.compute_tool_pose(self.joint_positions + step)
        step *= _limiting_share(pos - self.tool_pos_w, self._step_s * speed_m_s)
        pos_w, q_w = self.compute_tool_pose(self.joint_positions + step)
        return self.solve_inverse_kinematics(pos_w, _limit_tilt(q_w, tilt_rad), self.joint_positions + step)

    def compute_action_to_joint_positions(self, joint_positions: FloatArray) -> FloatArray:
        """Returns actions (N, A) that move the arms to joint positions (N, J) within the speed limits.

        All joints move in proportion. A driving base turns back to its initial yaw.
        """
        self._update()
        step = self._within_limits(joint_positions - self.joint_positions)
        self._set_positions(self.joint_positions + step)
        share = step / self._reach
        if self._drive is None:
            return share
        yaw = self._simulation.get_base_displacement()[:, 2:]
        turn = np.clip(-YAW_GAIN_PER_S * yaw / self._drive.turn_limit_rad_s, -1.0, 1.0)
        return np.concatenate([share[:, 1:], share[:, :1], turn], axis=-1)

    def find_joint_positions(
        self, pos_w: FloatArray, q_w: FloatArray, tilt_rad: float = np.pi
    ) -> tuple[FloatArray, FloatArray]:
        """Finds joint positions near the current ones for K tool poses in each world, (N, K, 3) and (N, K, 4).

        The cost is the duration of the motion, plus the collision cost, plus ``TILT_COST_S_PER_RAD`` per radian of
        excess tilt. The collision cost begins at a distance of ``COLLISION_MARGIN_M``. For a collision it is at least
        ``COLLISION_COST_S``. At the end of the motion, collisions of the tool are not checked. The cost is infinite if
        no solution was found.

        Returns:
            Joint positions (N, K, J), and costs (N, K) in seconds.
        """
        worlds, poses = q_w.shape[:2]
        to_base_pos, to_base_q = (part[:, None] for part in self._to_base)
        pos, q = transforms.compose(to_base_pos, to_base_q, pos_w, q_w)
        joints = self.joint_positions.shape[-1]
        starts = self.joint_positions[:, None, None] + self._chain.joint_scales * _start_offsets(joints)
        starts = np.tile(starts, (1, poses, 1, 1)).reshape(-1, joints)
        pos, q = (np.repeat(part.reshape(worlds * poses, -1), NUM_IK_STARTS, axis=0) for part in (pos, q))
        solution = kinematics.inverse_kinematics(self._chain, pos, q, starts)
        angles = self._unwrap_near(solution.joint_positions.reshape(worlds, -1, joints))
        missed = (solution.position_error_m > MAX_POSITION_ERROR_M) | (
            solution.rotation_error_rad > MAX_ROTATION_ERROR_RAD
        )
        cost = np.where(missed.reshape(worlds, -1), np.inf, self._swing_cost_s(angles, tilt_rad))
        cost, angles = _cheapest(
            cost.reshape(worlds, poses, -1), angles.reshape(worlds, poses, -1, joints), CHECKED_IK_SOLUTIONS
        )
        cost += self._collision_cost_s(angles.reshape(worlds, -1, joints)).reshape(cost.shape)
        cost, angles = _cheapest(cost, angles, 1)
        return angles[:, :, 0], cost[:, :, 0]

    def _swing_cost_s(self, joint_positions: FloatArray, tilt_rad: float) -> FloatArray:
        """Returns the duration (N, M) of motions to joint positions (N, M, J), plus the cost of tool tilt."""
        way = joint_positions - self.joint_positions[:, None]
        tilt = [
            self._tilt_rad(self.joint_positions[:, None] + share * way) for share in CHECKED_PATH_FRACTIONS
        ]
        excess = np.maximum(0.0, np.max(tilt, axis=0) - tilt_rad)
        return self._step_s * np.abs(way / self._reach).max(axis=-1) + TILT_COST_S_PER_RAD * excess

    def _collision_cost_s(self, joint_positions: FloatArray) -> FloatArray:
        """Returns the cost (N, M) of small distances on the path to joint positions (N, M, J)."""
        way = joint_positions - self.joint_positions[:, None]
        state, gap = self._episodes.get_state(), np.full(way.shape[:2], np.inf)
        for share in CHECKED_PATH_FRACTIONS:
            there = self.joint_positions[:, None] + share * way
            gap = np.minimum(gap, self.compute_clearance_m(there, state, tool=share < 1.0))
        return COLLISION_COST_S * np.maximum(0.0, 1.0 - gap / COLLISION_MARGIN_M)

    def compute_clearance_m(self, joint_positions: FloatArray, state: State, *, tool: bool) -> FloatArray:
        """Returns the smallest distance (N, M) in metres from person or furniture at joint positions (N, M, J).

        See ``RobotClearance.compute_min_distance_m``.
        """
        return self._clearance.compute_min_distance_m(
            joint_positions, state.person_capsule_ends_w, state.person_radius_m, tool=tool
        )

    def _tilt_rad(self, joint_positions: FloatArray) -> FloatArray:
        """Returns the angle (N, M) between the tool's z axis and the vertical at joint positions (N, M, J)."""
        _, q = kinematics.forward_kinematics(
            self._chain, joint_positions.reshape(-1, joint_positions.shape[-1])
        )
        z_w = transforms.rotate(
            self._base_w[1][:, None], transforms.rotate(q, UP).reshape(*joint_positions.shape[:2], 3)
        )
        return elementary.arccos(np.clip(z_w[..., 2], -1.0, 1.0))

    def solve_inverse_kinematics(self, pos_w: FloatArray, q_w: FloatArray, near: FloatArray) -> FloatArray:
        """Returns joint positions (N, J) for a tool pose, by inverse kinematics that starts at ``near`` (N, J)."""
        pos, q = transforms.compose(*self._to_base, pos_w, q_w)
        return kinematics.inverse_kinematics(
            self._chain, pos, q, near, iterations=IK_ITERATIONS
        ).joint_positions

    def compute_tool_pose(self, joint_positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns tool positions (N, 3) and rotations (N, 4) in the world frame, at joint positions (N, J)."""
        return transforms.compose(*self._base_w, *kinematics.forward_kinematics(self._chain, joint_positions))

    def compute_max_joint_distance_rad(self, joint_positions: FloatArray) -> FloatArray:
        """Returns the largest difference (N,) of a joint from ``joint_positions`` (N, J), in the chain's units."""
        return np.abs((joint_positions - self.joint_positions) / self._chain.joint_scales).max(axis=-1)

    def _unwrap_near(self, joint_positions: FloatArray) -> FloatArray:
        """Returns joint positions (N, M, J), moved by whole turns towards the current positions.

        Positions outside of a joint's range are not moved.
        """
        turns = np.round((self.joint_positions[:, None] - joint_positions) / (2.0 * np.pi))
        turned = joint_positions + 2.0 * np.pi * turns
        inside = (turned >= self._chain.lower_limit) & (turned <= self._chain.upper_limit)
        return np.where(inside, turned, joint_positions)

    def _update(self) -> None:
        """Continue the plan from the current servo targets."""
        self._continue_from(self._simulation.get_joint_targets())

    def _continue_from(self, of_arm: FloatArray) -> None:
        """Continue from joint positions of the arm (N, J) and from the current pose of the base."""
        if self._drive is None:
            self._set_positions(of_arm)
            return
        travel_m = self._simulation.get_base_displacement()[:, :1]
        pos_w, q_w = self._simulation.get_base_pose()
        self._base_w = pos_w - travel_m * transforms.rotate(q_w, placement.X_AXIS), q_w
        self._to_base = transforms.invert(*self._base_w)
        self._set_positions(np.concatenate([travel_m, of_arm], axis=-1))

    def _set_positions(self, joint_positions: FloatArray) -> None:
        self.joint_positions = joint_positions
        self.tool_pos_w, self.tool_quat_w = self.compute_tool_pose(joint_positions)

    def _within_limits(self, step: FloatArray) -> FloatArray:
        return step / np.maximum(1.0, np.abs(step / self._reach).max(axis=-1, keepdims=True))


def _start_offsets(joints: int) -> FloatArray:
    """Returns the offsets (``NUM_IK_STARTS``, J) of the start poses from the current pose, in the chain's units."""
    others = random_streams.make_planner_start_rng().uniform(
        -MAX_IK_START_OFFSET_RAD, MAX_IK_START_OFFSET_RAD, (NUM_IK_STARTS - 1, joints)
    )
    return np.concatenate([np.zeros((1, joints)), others])


def _cheapest(cost: FloatArray, joint_positions: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """Returns the ``count`` lowest costs of (N, K, R) and their joint positions (N, K, R, J), in ascending order."""
    best = np.argsort(cost, axis=-1, kind="stable")[..., :count]
    return np.take_along_axis(cost, best, axis=-1), np.take_along_axis(
        joint_positions, best[..., None], axis=2
    )


def _limiting_share(step: FloatArray, longest: FloatArray | float) -> FloatArray:
    """Returns the factor (N, 1) that limits steps (N, k) to a length (N,)."""
    length = transforms.norm(step)
    return np.minimum(1.0, longest / np.maximum(length, 1e-9))[:, None]


def _limit_tilt(q_w: FloatArray, tilt_rad: float) -> FloatArray:
    """Returns rotations (N, 4), turned by the smallest angle after which their z axes are near the vertical.

    The remaining angle is at most ``tilt_rad``.
    """
    z_w = transforms.rotate(q_w, UP)
    axis = transforms.cross(z_w, UP)
    sine = transforms.norm(axis)
    excess = np.maximum(0.0, elementary.arctan2(sine, z_w[:, 2]) - tilt_rad)
    back = axis * (excess / np.maximum(sine, 1e-9))[:, None]
    return transforms.multiply(transforms.from_rotation_vector(back), q_w)
