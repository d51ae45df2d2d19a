"""Where the robot's arm begins."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from avrgym import kinematics, transforms
from avrgym.models.scene import TOOL_BODY, Stage, robot_with_tool

Array = NDArray[np.float64]


@cache
def arm_chain(stage: Stage) -> kinematics.Chain:
    """The arm of the stage's robot, from its base to the tool."""
    model = robot_with_tool(stage, appearance=False).compile()
    return kinematics.chain_of(model, stage.robot.arm_joints, stage.robot.base, TOOL_BODY)


def start_angles(stage: Stage, tool_pos_w: Array, tool_q_w: Array, uniforms: Array) -> Array:
    """Arm angles (n, 7), near the seed pose, that put the tool at positions (n, 3) and rotations (n, 4).

    ``uniforms`` (n, ``kinematics.RESTART_UNIFORMS``) drive the restarts where the seed pose does not lead
    there.
    """
    base_pos, base_q = transforms.invert(stage.robot_pos_w, stage.robot_q_w)
    pos, q = transforms.compose(base_pos, base_q, tool_pos_w, tool_q_w)
    return kinematics.solve_with_restarts(arm_chain(stage), pos, q, stage.robot.seed_pose_rad, uniforms)
