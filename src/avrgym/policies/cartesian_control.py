"""Cartesian velocity control of the robot's hand, for a human operator."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.kinematics import compute_action_jacobian, extract_chain
from avrgym.models import robot
from avrgym.simulation.worlds import Simulation

HAND_SPEED_LIMIT_M_S = 0.25
HAND_ANGULAR_SPEED_LIMIT_RAD_S = 0.8
LEAST_SQUARES_DAMPING = 0.05
"""Damping factor of damped least squares (Wampler, IEEE Trans. Syst. Man Cybern. 16, 1986). It reduces joint speeds
near singularities."""


class CartesianController:
    """Computes the actions for commanded velocities of the robot's hand, in the first world."""

    def __init__(self, simulation: Simulation) -> None:
        """Read the kinematic chain of the arm from the scene of a simulation."""
        scene = simulation.scene
        joints = [robot.ROBOT_NAME_PREFIX + joint for joint in scene.arm.joints]
        ends = robot.ROBOT_NAME_PREFIX + scene.robot.base, robot.ROBOT_NAME_PREFIX + scene.arm.end_effector
        self.arm_chain = extract_chain(simulation.model, joints, *ends)
        self._simulation, self._speed_limit = simulation, scene.speed_limit
        self._drives = scene.robot.drive is not None

    def compute_action(self, linear: FloatArray, angular: FloatArray) -> FloatArray:
        """Returns the action (A,) for a velocity of the hand. If necessary, the action is scaled down to the speed
        limits of joints and hand.

        Args:
            linear: (3,) velocity of the hand's origin as a share of ``HAND_SPEED_LIMIT_M_S``, world frame; clipped to
                length 1.
            angular: (3,) angular velocity as a share of ``HAND_ANGULAR_SPEED_LIMIT_RAD_S``, world frame; clipped to
                length 1.
        """
        q_wb = self._base_q_w()
        velocity_w = (
            _shortened(linear) * HAND_SPEED_LIMIT_M_S,
            _shortened(angular) * HAND_ANGULAR_SPEED_LIMIT_RAD_S,
        )
        velocity_b = np.concatenate([transforms.rotate(transforms.conjugate(q_wb), v) for v in velocity_w])
        j = self._jacobian()
        damped = np.asarray(j @ j.T + LEAST_SQUARES_DAMPING**2 * np.eye(6), float)
        speeds = np.asarray(j.T @ np.linalg.solve(damped, velocity_b), float)
        shares, reached = speeds / self._speed_limit, np.asarray(j @ speeds, float)
        excess = (
            np.abs(shares).max(),
            np.linalg.norm(reached[:3]) / HAND_SPEED_LIMIT_M_S,
            np.linalg.norm(reached[3:]) / HAND_ANGULAR_SPEED_LIMIT_RAD_S,
        )
        return shares / max(1.0, *excess)

    def compute_hand_velocity(self, action: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the linear (m/s) and angular (rad/s) velocity (3,) of the hand for an action (A,), world frame."""
        twist_b = self._jacobian() @ (action * self._speed_limit)
        q_wb = self._base_q_w()
        return transforms.rotate(q_wb, twist_b[:3]), transforms.rotate(q_wb, twist_b[3:])

    def _jacobian(self) -> FloatArray:
        """Returns the Jacobian (6, A) of the hand in the frame of the robot's base."""
        positions = self._simulation.get_joint_positions()[:1]
        return compute_action_jacobian(self.arm_chain, positions, drives=self._drives)[0]

    def _base_q_w(self) -> FloatArray:
        return self._simulation.get_base_pose()[1][0]


def _shortened(vector: FloatArray) -> FloatArray:
    return vector / max(1.0, float(np.linalg.norm(vector)))
