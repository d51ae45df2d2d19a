"""Rehearsal: computes the cost of a planned tool motion without physics. The cost depends on clearance and joint
limits.

Inverse kinematics follows the path of the tool in small steps, as experts do.
"""

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import kinematics, transforms
from avrgym.models.human import People
from avrgym.models.scene import SceneConfig
from avrgym.people.arm_clearance import compute_person_capsules
from avrgym.simulation import base_search
from avrgym.tasks.robot_clearance import RobotClearance, compute_min_self_distance_m

STEPS_PER_GOAL, IK_ITERATIONS = 6, 8
"""Number of steps from one goal to the next, and of iterations of the inverse kinematics in each step."""
CLEARANCE_MARGIN_M, JOINT_LIMIT_MARGIN_RAD = 0.02, 0.15
"""Distances from person and furniture, and from joint limits, below which the cost of a motion increases."""
MAX_WORLDS_PER_BATCH = 64
"""Number of worlds in one batch of computations. Small batches limit the memory."""
ALLOWED_POSITION_ERROR_M, ALLOWED_ROTATION_ERROR_RAD = 0.005, 0.05
PATH_FRACTIONS, PATH_IK_ITERATIONS = (0.0, 0.25, 0.5, 0.75, 1.0), 15
"""Positions on the path to a goal, 0 to 1, at which ``CollisionPathCost`` checks the arm.

The second value is the maximum number of iterations of the inverse kinematics.
"""
NUM_POSTURES = 16
"""Number of postures of a robot with a fixed base for which the motion is rehearsed."""


class GoalPathCost:
    """Computes the cost of the tool motion in n worlds, for several initial states of each world."""

    def __init__(
        self,
        scene: SceneConfig,
        chain: kinematics.Chain,
        people: People,
        start_pos_w: FloatArray,
        start_q_w: FloatArray,
        goal_pos_w: FloatArray,
        goal_q_w: FloatArray,
    ) -> None:
        """Store the path from the start poses, (n, 3) and (n, 4), through the goals, (n, G, 3) and (n, G, 4)."""
        self._scene, self._chain = scene, chain
        self._goals = goal_pos_w, goal_q_w
        self._path = _interpolated(
            np.concatenate([start_pos_w[:, None], goal_pos_w], axis=1),
            np.concatenate([start_q_w[:, None], goal_q_w], axis=1),
        )
        self._person = compute_person_capsules(people, scene.posture)

    def __call__(
        self, base_pos_w: FloatArray, yaw_rad: FloatArray, joint_positions: FloatArray
    ) -> FloatArray:
        """Returns the costs (n, K) in metres of K initial states, see ``base_search.PathCost``.

        The cost is a sum of three terms: the largest deviation from the path, the missing clearance from person and
        furniture, and the missing distance from joint limits.
        """
        parts = np.array_split(np.arange(len(yaw_rad)), -(-len(yaw_rad) // MAX_WORLDS_PER_BATCH))
        costs = [self._cost(part, base_pos_w[part], yaw_rad[part], joint_positions[part]) for part in parts]
        return np.concatenate(costs)

    def _cost(
        self, worlds: IntArray, base_pos_w: FloatArray, yaw_rad: FloatArray, joint_positions: FloatArray
    ) -> FloatArray:
        """Returns the costs (n, K) in metres of K initial states in the worlds ``worlds`` (n,)."""
        count, each = int(yaw_rad.shape[0]), int(yaw_rad.shape[1])
        world: IntArray = np.repeat(worlds, each)
        base_w = base_pos_w.reshape(-1, 3), transforms.from_axis_angle([0.0, 0.0, 1.0], yaw_rad.reshape(-1))
        to_base = transforms.invert(*base_w)
        clearance = RobotClearance(self._scene, self._chain, *base_w)
        segments_w, radii_m = (part[world] for part in self._person)
        joints = joint_positions.reshape(len(world), -1)
        lower, upper, units = self._chain.lower_limit, self._chain.upper_limit, self._chain.joint_scales
        error_m, gap_m = np.zeros(len(world)), np.full(len(world), CLEARANCE_MARGIN_M)
        limit_rad = np.full(len(world), JOINT_LIMIT_MARGIN_RAD)
        for pos_w, q_w in zip(*self._path, strict=True):
            pos, q = transforms.compose(*to_base, pos_w[world], q_w[world])
            found = kinematics.inverse_kinematics(
                self._chain, pos, q, joints, iterations=IK_ITERATIONS, precision=np.float32
            )
            joints = found.joint_positions
            excess_m = np.maximum(found.position_error_m - ALLOWED_POSITION_ERROR_M, 0.0)
            excess_rad = np.maximum(found.rotation_error_rad - ALLOWED_ROTATION_ERROR_RAD, 0.0)
            error_m = np.maximum(error_m, excess_m + kinematics.METRES_PER_RADIAN * excess_rad)
            within = np.minimum(joints - lower, upper - joints) / units
            limit_rad = np.minimum(limit_rad, within.min(axis=-1))
            gap = clearance.compute_min_distance_m(joints[:, None], segments_w, radii_m, tool=False)[:, 0]
            gap_m = np.minimum(gap_m, gap)
        missing_rad = JOINT_LIMIT_MARGIN_RAD - limit_rad
        cost = error_m + CLEARANCE_MARGIN_M - gap_m + kinematics.METRES_PER_RADIAN * missing_rad
        return cost.reshape(count, each)

    def find_best_posture(
        self, base_pos_w: FloatArray, yaw_rad: float, joint_positions: FloatArray, uniforms: FloatArray
    ) -> FloatArray:
        """Returns the joint positions (n, J) with the lowest cost at the tool's start pose.

        The first candidate is ``joint_positions`` (n, J). Inverse kinematics from random poses around it finds the
        others.
        """
        count, joints = int(joint_positions.shape[0]), int(joint_positions.shape[1])
        shares = uniforms[:, : (NUM_POSTURES - 1) * joints].reshape(count, -1, joints)
        around = kinematics.MAX_RESTART_OFFSET_RAD * self._chain.joint_scales * (2.0 * shares - 1.0)
        starts = joint_positions[:, None] + np.concatenate([np.zeros((count, 1, joints)), around], axis=1)
        each = int(starts.shape[1])
        world: IntArray = np.repeat(np.arange(count), each)
        yaw = np.full((count, each), yaw_rad)
        base_w = base_pos_w[world], transforms.from_axis_angle([0.0, 0.0, 1.0], yaw.reshape(-1))
        pos, q = transforms.compose(*transforms.invert(*base_w), *(part[0][world] for part in self._path))
        found = kinematics.inverse_kinematics(self._chain, pos, q, starts.reshape(-1, joints))
        candidates = kinematics.wrap_angles(self._chain, found.joint_positions).reshape(starts.shape)
        cost = self(base_w[0].reshape(count, each, 3), yaw, candidates)
        return candidates[np.arange(count), cost.argmin(axis=-1)]


class CollisionPathCost(GoalPathCost):
    """Computes the cost of the paths from the start to each goal.

    The cost is positive if links are close to each other or to furniture.
    """

    def _cost(
        self, worlds: IntArray, base_pos_w: FloatArray, yaw_rad: FloatArray, joint_positions: FloatArray
    ) -> FloatArray:
        """Returns the missing distance (n, K) from ``CLEARANCE_MARGIN_M`` of the worst configuration on the paths.

        Only a few configurations are checked. Their joint positions are interpolated between start and goal. Goals out
        of reach are ignored.
        """
        count, each = int(yaw_rad.shape[0]), int(yaw_rad.shape[1])
        world: IntArray = np.repeat(worlds, each)
        base_w = base_pos_w.reshape(-1, 3), transforms.from_axis_angle([0.0, 0.0, 1.0], yaw_rad.reshape(-1))
        to_base = transforms.invert(*base_w)
        clearance = RobotClearance(self._scene, self._chain, *base_w)
        start = joint_positions.reshape(len(world), -1)
        gap_m = np.full(len(world), CLEARANCE_MARGIN_M)
        for goal in range(self._goals[0].shape[1]):
            pos, q = transforms.compose(*to_base, *(part[world, goal] for part in self._goals))
            found = kinematics.inverse_kinematics(
                self._chain, pos, q, start, iterations=PATH_IK_ITERATIONS, precision=np.float32
            )
            reached = found.position_error_m < base_search.MAX_GOAL_ERROR_M
            for share in PATH_FRACTIONS:
                joints = start + share * (found.joint_positions - start)
                gap = np.minimum(
                    clearance.compute_furniture_distance_m(joints),
                    compute_min_self_distance_m(self._scene, self._chain, joints),
                )
                gap_m = np.minimum(gap_m, np.where(reached, gap, CLEARANCE_MARGIN_M))
        return (CLEARANCE_MARGIN_M - gap_m).reshape(count, each)


def _interpolated(pos_w: FloatArray, q_w: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns poses on the lines between P poses, (n, P, 3) and (n, P, 4), with the step axis W first: (W, n, 3) and
    (W, n, 4)."""
    way = pos_w[:, 1:] - pos_w[:, :-1]
    turn = transforms.to_rotation_vector(transforms.multiply(q_w[:, 1:], transforms.conjugate(q_w[:, :-1])))
    found_pos, found_q = [pos_w[:, 0]], [q_w[:, 0]]
    for part in range(way.shape[1]):
        for share in np.arange(1, STEPS_PER_GOAL + 1) / STEPS_PER_GOAL:
            found_pos.append(pos_w[:, part] + share * way[:, part])
            found_q.append(
                transforms.multiply(transforms.from_rotation_vector(share * turn[:, part]), q_w[:, part])
            )
    return np.stack(found_pos), np.stack(found_q)
