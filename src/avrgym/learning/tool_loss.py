"""Loss of imitation by recurrent policies: the motion error of the tool.

An action error at the shoulder moves the tool by centimetres, the same error at the wrist by millimetres. Errors of
several joints can add up or cancel. Least squares over actions ignore these differences. The weight of an error
decreases with the demonstrated motion, because slow motions near the skin need more precision.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import numpy as np
import torch
from torch import Tensor

from avrgym.array_types import Float32Array
from avrgym.geometry.kinematics import compute_action_jacobian
from avrgym.models.scene import SceneConfig
from avrgym.tasks.placement import make_arm_chain

LOSS_TRANSLATION_UNIT_M, LOSS_ROTATION_UNIT_RAD = 0.02, 0.2
"""Units of the tool's translation and rotation in a control step. With a lever arm of 0.1 m, a rotation of one unit
moves a point by one unit."""
HALF_WEIGHT_TOOL_MOTION = 0.25
"""Demonstrated motion at which the weight of the error is a half: 0.25 units, which is 5 mm or 0.05 rad. At ten times
this motion the weight is about 0.01."""
ACTION_ERROR_WEIGHT = 0.1
"""Weight of the squared action error. It penalises errors of the elbow that do not move the tool."""


class ToolMotionModel:
    """Computes the tool's motion from the actions of a scene's robot."""

    def __init__(self, scene: SceneConfig) -> None:
        self._chain = make_arm_chain(scene)
        self._reach = scene.speed_limit * scene.control_step_s
        self._drives = scene.robot.drive is not None

    def compute_scaled_jacobian(self, joint_positions: Float32Array) -> Tensor:
        """Returns the Jacobian (..., 6, A) of the tool's motion in a control step, at joint positions (..., J).

        Rows 0–2 are translations along x, y and z in ``LOSS_TRANSLATION_UNIT_M``. Rows 3–5 are rotations about x, y
        and z in ``LOSS_ROTATION_UNIT_RAD``. Both are in the frame of the robot's base. Column a is the motion if
        action a is 1 and all other actions are 0.
        """
        joints = joint_positions.shape[-1]
        positions = joint_positions.reshape(-1, joints).astype(np.float64)
        by_speed = compute_action_jacobian(self._chain, positions, drives=self._drives)
        units = np.repeat([LOSS_TRANSLATION_UNIT_M, LOSS_ROTATION_UNIT_RAD], 3)[:, None]
        motion_per_action = (by_speed * self._reach / units).astype(np.float32)
        return torch.as_tensor(motion_per_action.reshape(*joint_positions.shape[:-1], 6, len(self._reach)))


def compute_tool_motion_loss(actions: Tensor, demonstrated: Tensor, motion_per_action: Tensor) -> Tensor:
    """Returns the mean squared error of the tool's motion and of the actions, weighted by ``HALF_WEIGHT_TOOL_MOTION``.

    ``actions`` and ``demonstrated`` actions are (..., A). ``motion_per_action`` (..., 6, A) is from
    ``ToolMotionModel.compute_scaled_jacobian``.
    """
    error = actions - demonstrated
    motion, motion_error = ((motion_per_action @ each[..., None])[..., 0] for each in (demonstrated, error))
    squared = motion_error.square().mean(dim=-1) + ACTION_ERROR_WEIGHT * error.square().mean(dim=-1)
    return (squared / (1.0 + motion.square().sum(dim=-1) / HALF_WEIGHT_TOOL_MOTION**2)).mean()
