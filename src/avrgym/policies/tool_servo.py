"""Position control of the robot's tool by a hand-held controller. The tool repeats the relative motion of the
controller.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.kinematics import Chain, compute_jacobian
from avrgym.models import robot
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.policies.cartesian_control import HAND_ANGULAR_SPEED_LIMIT_RAD_S, HAND_SPEED_LIMIT_M_S
from avrgym.simulation.worlds import Simulation

POSE_GAIN_PER_S = 8.0
"""Speed of the tool divided by its distance from the target pose, 1/s."""
MAX_TARGET_POSITION_ERROR_M = 0.05
MAX_TARGET_ORIENTATION_ERROR_RAD = 0.16
"""Maximum distance of the target pose from the tool. At this distance the speed limits apply. Faster motion of the
controller has no effect. The tool therefore stops soon after the controller."""


class ToolServo:
    """Computes the velocities of the robot's hand with which its tool follows a controller, in the first world.

    ``store_reference_poses`` stores the current poses of tool and controller as reference poses (the clutch). The
    target pose of the tool is its reference pose, plus the motion of the controller since ``store_reference_poses``.
    Translations are multiplied by a scale, rotations are not. The pose of the tool is that of the servo targets. The
    tool therefore does not overshoot when its servos lag behind.
    """

    def __init__(self, simulation: Simulation, chain: Chain) -> None:
        """Find hand and tool in the scene. ``chain``: kinematic chain of the arm."""
        names = simulation.bodies
        self._simulation, self._chain = simulation, chain
        self._tool = names.index(SCENE_TOOL_BODY)
        self._hand = names.index(robot.ROBOT_NAME_PREFIX + simulation.scene.arm.end_effector)

    def store_reference_poses(self, pos_w: FloatArray, q_w: FloatArray, scale: float) -> None:
        """Stores the current pose of the tool and a pose of the controller, position (3,) and quaternion (4,), as
        references."""
        poses = self._simulation.get_body_poses(0)
        tool, hand = poses[self._tool], poses[self._hand]
        hand_inverse = transforms.invert(hand[:3], hand[3:])
        self._tool_in_hand = transforms.compose(*hand_inverse, tool[:3], tool[3:])
        _, self._tool_pos_w, self._tool_q_w = self._commanded()
        self._pos_w, self._q_w, self._scale = pos_w, q_w, scale

    def compute_hand_velocity(self, pos_w: FloatArray, q_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns the hand's linear and angular velocity (3,), divided by their limits, for ``CartesianController``.

        ``pos_w`` (3,) and ``q_w`` (4,): pose of the controller in the world frame. Call ``store_reference_poses``
        first.
        """
        hand_pos_w, tool_pos_w, tool_q_w = self._commanded()
        turned = transforms.multiply(q_w, transforms.conjugate(self._q_w))
        way = self._tool_pos_w + self._scale * (pos_w - self._pos_w) - tool_pos_w
        turn = transforms.to_rotation_vector(
            transforms.multiply(transforms.multiply(turned, self._tool_q_w), transforms.conjugate(tool_q_w))
        )
        lead, lead_turn = (
            _limited(way, MAX_TARGET_POSITION_ERROR_M),
            _limited(turn, MAX_TARGET_ORIENTATION_ERROR_RAD),
        )
        self._tool_pos_w = self._tool_pos_w + lead - way
        target_q_w = transforms.multiply(transforms.from_rotation_vector(lead_turn), tool_q_w)
        self._tool_q_w = transforms.multiply(transforms.conjugate(turned), target_q_w)
        linear, angular = POSE_GAIN_PER_S * lead, POSE_GAIN_PER_S * lead_turn
        of_hand = linear + np.cross(angular, hand_pos_w - tool_pos_w)
        return of_hand / HAND_SPEED_LIMIT_M_S, angular / HAND_ANGULAR_SPEED_LIMIT_RAD_S

    def _commanded(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Returns the position (3,) of the hand, and position (3,) and quaternion (4,) of the tool, at the servo
        targets; world frame."""
        pos_b, q_b, _ = compute_jacobian(self._chain, self._simulation.get_joint_targets()[:1])
        base_pos_w, base_q_w = self._simulation.get_base_pose()
        hand_pos_w, hand_q_w = transforms.compose(base_pos_w[0], base_q_w[0], pos_b[0], q_b[0])
        return hand_pos_w, *transforms.compose(hand_pos_w, hand_q_w, *self._tool_in_hand)


def _limited(vector: FloatArray, limit: float) -> FloatArray:
    """Returns a vector (3,), shortened to the length ``limit`` if it is longer."""
    return vector * min(1.0, limit / max(float(np.linalg.norm(vector)), 1e-12))
