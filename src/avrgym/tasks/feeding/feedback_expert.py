"""Feedback expert for feeding. Its actions depend only on the current state."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import angle_between, norm
from avrgym.simulation.worlds import State
from avrgym.tasks.experts.feedback import (
    MAX_SPEED_M_S,
    ToolTarget,
    compute_funnel_standoff_m,
    compute_tool_speed_m_s,
)
from avrgym.tasks.experts.head_clearance import compute_direction_into_face_w
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.feeding import expert
from avrgym.tasks.task import TaskState

CANDIDATE_YAWS_RAD = np.radians([0.0, -30.0, -60.0, -90.0])
"""Candidate yaw angles: tip first, or rotated towards the left side, which needs a smaller reach."""
ROTATION_ERROR_COST_M_PER_RAD, YAW_COST_M_PER_RAD = 0.1, 0.02
"""Costs in metres: per radian of rotation error, and per radian of yaw."""


def compute_feeding_target(
    state: State,
    task_state: TaskState,
    planner: MotionPlanner,
    standoff_from_mouth_m: FloatArray | float = 0.0,
) -> ToolTarget:
    """Returns the next tool target: the level spoon moves into the mouth, through a funnel in front of the face.

    The spoon has the candidate yaw that the arm reaches best. The spoon stays at least ``standoff_from_mouth_m`` (N,)
    in front of the mouth.
    """
    into = compute_direction_into_face_w(state)
    goal_w, q_w = _within_reach(state, planner, elementary.arctan2(into[:, 1], into[:, 0]))
    back_m = np.maximum(
        compute_funnel_standoff_m(goal_w - planner.tool_pos_w, into, 0.005, expert.STANDOFF_M),
        standoff_from_mouth_m,
    )
    speed = np.where(
        np.greater(standoff_from_mouth_m, 0.0),
        MAX_SPEED_M_S,
        compute_tool_speed_m_s(goal_w - planner.tool_pos_w, expert.INSERTION_SPEED_M_S),
    )
    return goal_w - back_m[:, None] * into, q_w, speed


def _within_reach(state: State, planner: MotionPlanner, yaw_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns spoon position (N, 3) and rotation (N, 4) of the candidate with the lowest cost.

    The cost in metres is the error of the inverse kinematics plus a cost of yaw.
    """
    clearance_m = np.full(len(yaw_rad), expert.CLEARANCE_M)
    goals_w: list[FloatArray] = []
    rotations_w: list[FloatArray] = []
    costs_m: list[FloatArray] = []
    for turn in CANDIDATE_YAWS_RAD.tolist():
        q_w = transforms.from_axis_angle(expert.UP, yaw_rad + turn)
        goal_w = expert.compute_spoon_pos_at_mouth_w(planner.scene.tool, state, q_w, 0.0, clearance_m)
        reached_w, reached_q_w = planner.compute_tool_pose(
            planner.solve_inverse_kinematics(goal_w, q_w, planner.joint_positions)
        )
        missed_m = norm(reached_w - goal_w) + ROTATION_ERROR_COST_M_PER_RAD * angle_between(reached_q_w, q_w)
        costs_m.append(missed_m + YAW_COST_M_PER_RAD * abs(turn))
        goals_w.append(goal_w)
        rotations_w.append(q_w)
    best, world = np.argmin(costs_m, axis=0), np.arange(len(yaw_rad))
    return np.stack(goals_w)[best, world], np.stack(rotations_w)[best, world]
