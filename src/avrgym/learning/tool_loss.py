"""Loss of imitation by recurrent policies: the motion error of the tool.

An action error at the shoulder moves the tool by centimetres, an error at the wrist by millimetres. Errors of several
joints add up or cancel. Least squares over actions ignore this. Errors are weighted relative to the demonstrated
motion, because slow motions near the skin need more precision.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import numpy as np
import torch
from torch import Tensor

from avrgym.array_types import Float32Array
from avrgym.geometry.kinematics import action_jacobian
from avrgym.models.scene import SceneConfig
from avrgym.tasks.placement import arm_chain

UNIT_M, UNIT_RAD = 0.02, 0.2
"""Errors of position and rotation in a control step that count as 1; at a lever of 0.1 m they are equal."""
MOTION_SCALE = 0.25
"""Demonstrated motion (5 mm, or 0.05 rad) that halves the weight of its error. Ten times this motion reduces the weight
to a hundredth."""
ACTIONS_WEIGHT = 0.1
"""Weight of the error of actions, for motions of the elbow that do not move the tool."""


class ToolMotion:
    """Computes the tool's motion from the actions of a scene's robot."""

    def __init__(self, scene: SceneConfig) -> None:
        self._chain = arm_chain(scene)
        self._reach = scene.speed_limit * scene.control_step_s
        self._drives = scene.robot.drive is not None

    def per_action(self, joint_positions: Float32Array) -> Tensor:
        """The tool's motion in a control step (..., 6, A) for actions of 1, of arms at joint positions (..., J).

        Rows 0–2 are translations along x, y and z of the robot's base in ``UNIT_M``, rows 3–5 rotations in
        ``UNIT_RAD``.
        """
        joints = joint_positions.shape[-1]
        positions = joint_positions.reshape(-1, joints).astype(np.float64)
        by_speed = action_jacobian(self._chain, positions, drives=self._drives)
        units = np.repeat([UNIT_M, UNIT_RAD], 3)[:, None]
        per_action = (by_speed * self._reach / units).astype(np.float32)
        return torch.as_tensor(per_action.reshape(*joint_positions.shape[:-1], 6, len(self._reach)))


def tool_loss(actions: Tensor, demonstrated: Tensor, per_action: Tensor) -> Tensor:
    """Mean squared error of the tool's motion and of the actions, relative to the demonstrated motion.

    Actions are (..., J), ``per_action`` (..., 6, J) is from ``ToolMotion``.
    """
    error = actions - demonstrated
    motion, motion_error = ((per_action @ each[..., None])[..., 0] for each in (demonstrated, error))
    squared = motion_error.square().mean(dim=-1) + ACTIONS_WEIGHT * error.square().mean(dim=-1)
    return (squared / (1.0 + motion.square().sum(dim=-1) / MOTION_SCALE**2)).mean()
