"""How far wrong actions lead a tool: what a policy that remembers makes least when it imitates.

The same error of an action moves the tool by centimetres at the shoulder and by millimetres at the wrist, and the
errors of several joints add up or cancel. Least squares over the actions alone do not know: a cup at somebody's lips
they left more wrong, up and down, than if it had not moved at all. And what is a small error on the way is a large one
at the skin, where a scratching tip is led by tenths of a millimetre: an error counts by what share of the motion it is.
"""

# PyTorch's methods: their types are known only in part.
# pyright: reportUnknownMemberType=false

import numpy as np
import torch
from torch import Tensor

from avrgym.array_types import Float32Array
from avrgym.geometry.kinematics import jacobian
from avrgym.models.scene import CONTROL_STEP_S, SceneConfig
from avrgym.tasks.placement import arm_chain

UNIT_M, UNIT_RAD = 0.02, 0.2
"""By how much a tool is moved and turned wrong in a control step that counts as 1: at 0.1 m these are the same."""
SLOW = 0.25
"""A motion so long (5 mm, or 0.05 rad) halves what an error counts, and one ten times as long takes it to a
hundredth; shorter ones are all alike."""
ACTIONS_WEIGHT = 0.1
"""What an action's own error counts: for turns of the elbow that leave the tool where it is."""


class ToolMotion:
    """How actions of a scene's robot move its tool."""

    def __init__(self, scene: SceneConfig) -> None:
        """Of the scene's moving arm."""
        self._chain = arm_chain(scene)
        self._reach_rad = scene.arm.speed_limit_rad_s * CONTROL_STEP_S

    def per_action(self, arm_angles_rad: Float32Array) -> Tensor:
        """What action 1 of each joint does in a control step, (..., 6, J), to the tools of arms at angles (..., J).

        Rows 0–2 are along x, y and z of the robot's base, in ``UNIT_M``; rows 3–5 about them, in ``UNIT_RAD``.
        """
        joints = arm_angles_rad.shape[-1]
        _, _, per_rad = jacobian(self._chain, arm_angles_rad.reshape(-1, joints).astype(np.float64))
        units = np.repeat([UNIT_M, UNIT_RAD], 3)[:, None]
        per_action = (per_rad * self._reach_rad / units).astype(np.float32)
        return torch.as_tensor(per_action.reshape(*arm_angles_rad.shape[:-1], 6, joints))


def tool_error(actions: Tensor, wanted: Tensor, per_action: Tensor) -> Tensor:
    """The mean squared error of tools, and a little of the actions' own: the less the faster the tool is to go.

    By actions (..., J) in place of those wanted, which move tools by ``per_action`` (..., 6, J) each.
    """
    wrong = actions - wanted
    meant, moved = ((per_action @ each[..., None])[..., 0] for each in (wanted, wrong))
    error = moved.square().mean(dim=-1) + ACTIONS_WEIGHT * wrong.square().mean(dim=-1)
    return (error / (1.0 + meant.square().sum(dim=-1) / SLOW**2)).mean()
