"""Experts for dressing: pull the sleeve's opening along the arm, from a point in front of the hand to the shoulder.

The target depends on the current state only. The opening faces along the arm. Its direction changes gradually at wrist
and elbow. The robot's hand is on the outer side of the person's arm.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.transforms import norm
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import State
from avrgym.tasks.dressing.reward import (
    DRESSED_SHOULDER_DISTANCE_M,
    ArmPath,
    compute_arm_path,
    find_nearest_path_point,
    is_dressed,
)
from avrgym.tasks.experts.feedback import SPEED_GAIN_PER_S, TURN_SPEED_RAD_S, ToolTarget
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import RunningEpisodes, TaskState

HAND_DIRECTION_MOUNTED_W, HAND_DIRECTION_FLOOR_W = (
    np.array([0.985, 0.0, -0.174]),
    np.array([0.766, 0.0, 0.643]),
)
"""Directions from the person's arm to the robot's hand, world frame. For a robot on the wheelchair: 10° below the
horizontal.

For a robot on the floor: 40° above the horizontal. With these directions the robots reach the whole arm.
"""
BEND_TRANSITION_DISTANCE_M = 0.06
"""Distance from wrist and elbow over which the direction of the opening changes."""
LOOKAHEAD_DISTANCE_M = 0.05
MAX_CENTRED_OFFSET_M, LATERAL_GAIN = 0.03, 1.5
"""Maximum distance of the opening's centre from the arm's axis at which the opening moves over the hand.

At larger distances the opening waits in front of the hand. The distance of the opening from the hand increases by
``LATERAL_GAIN`` times the excess.
"""
PULL_SPEED_M_S, APPROACH_SPEED_M_S, MIN_SPEED_M_S = 0.12, 0.20, 0.02
COMFORTABLE_FORCE_N, MAX_FORCE_N = 3.0, 6.0
"""Range of the force on the person in which the speed of the tool decreases from full speed to zero.

At higher forces the tool moves back along the arm.
"""
FREE_LAG_M, MAX_LAG_M = 0.03, 0.045
"""Range of the distance between tool and planned position in which the speed of the tool decreases to zero.

A large distance means that an obstacle blocks the tool.
"""
SHOULDER_OVERSHOOT_M = 0.04
"""Distance of the hoop's goal beyond the point at which the arm is dressed.

The half of the opening that is not fixed to the hoop lags behind.
"""


def compute_sleeve_opening_quat_w(scene: SceneConfig, along_w: FloatArray) -> FloatArray:
    """Returns rotations (..., 4) of the opening for pulling directions (..., 3).

    The mount of the robot determines the side of the arm on which its hand is.
    """
    xp = get_namespace(along_w)
    side = constant_like(
        HAND_DIRECTION_FLOOR_W if scene.mount.is_on_floor else HAND_DIRECTION_MOUNTED_W, along_w
    )
    across = side - (side * along_w).sum(axis=-1)[..., None] * along_w
    x = -transforms.normalize(across)
    return transforms.from_matrix(xp.stack([x, along_w, transforms.cross(x, along_w)], axis=-1))


def compute_pulling_target(state: State, task_state: TaskState, planner: MotionPlanner) -> ToolTarget:
    """Returns the next tool target: a motion of the opening along the arm.

    The tool stops if the arm is dressed. It moves back if the force is high or an obstacle blocks it.
    """
    path = compute_arm_path(state)
    end_m = path.section_end_distance_m[:, 2] - DRESSED_SHOULDER_DISTANCE_M + SHOULDER_OVERSHOOT_M
    here = find_nearest_path_point(planner.tool_pos_w, path, extended=True)
    beside_m = norm(planner.tool_pos_w - here.pos_w)
    wait_m = -BEND_TRANSITION_DISTANCE_M - LATERAL_GAIN * np.maximum(beside_m - MAX_CENTRED_OFFSET_M, 0.0)
    before = here.path_distance_m < 0.0
    limit_m = np.where(before & (beside_m > MAX_CENTRED_OFFSET_M), wait_m, end_m)
    lag_m = norm(state.tool_pos_w - planner.tool_pos_w)
    free_share = np.minimum(
        (MAX_FORCE_N - state.total_force_n) / (MAX_FORCE_N - COMFORTABLE_FORCE_N),
        (MAX_LAG_M - lag_m) / (MAX_LAG_M - FREE_LAG_M),
    )
    centred_share = np.clip(2.0 - beside_m / MAX_CENTRED_OFFSET_M, 0.0, 1.0)
    step_m = LOOKAHEAD_DISTANCE_M * np.where(before, 1.0, centred_share)
    backs = free_share < 0.0
    ahead_m = np.where(
        backs, here.path_distance_m - LOOKAHEAD_DISTANCE_M, np.minimum(here.path_distance_m + step_m, limit_m)
    )
    place_w, _ = _path_point(path, ahead_m)
    _, along_w = _path_point(path, here.path_distance_m)
    share = np.minimum(np.abs(free_share), 1.0)
    drawn = np.minimum(PULL_SPEED_M_S, SPEED_GAIN_PER_S * np.abs(end_m - here.path_distance_m))
    speed = share * np.where(before, APPROACH_SPEED_M_S, np.maximum(drawn, MIN_SPEED_M_S))
    stays = is_dressed(task_state) & ~backs
    q_w = np.where(stays[:, None], planner.tool_quat_w, compute_sleeve_opening_quat_w(planner.scene, along_w))
    return place_w, q_w, np.where(stays, 0.0, speed)


def _path_point(path: ArmPath, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns points and directions, (N, 3) each, at distances (N,) along the arm.

    Directions change gradually at wrist and elbow.
    """
    start_m = path.section_end_distance_m - path.length_m
    low = np.where(np.arange(3) == 0, -np.inf, 0.0)
    part_m = np.minimum(np.maximum(at_m[:, None] - start_m, low), path.length_m)
    place_w = path.section_start_w[:, 0] + (part_m[..., None] * path.section_direction_w).sum(axis=1)
    share = np.clip(
        (at_m[:, None] - path.section_end_distance_m[:, :2]) / (2.0 * BEND_TRANSITION_DISTANCE_M) + 0.5,
        0.0,
        1.0,
    )[..., None]
    along_w = path.section_direction_w[:, 0] + (
        share * (path.section_direction_w[:, 1:] - path.section_direction_w[:, :-1])
    ).sum(axis=1)
    return place_w, transforms.normalize(along_w)


class DressingExpert:
    """Pulls the sleeve along the arm. Plans start at the servo targets, not at the measured joint angles."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        """Start with the current joint angles of the robots."""
        self._episodes, self._planner = episodes, MotionPlanner(episodes)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        state, task_state = self._episodes.get_state(), self._episodes.task_state
        pos_w, q_w, speed = compute_pulling_target(state, task_state, self._planner)
        return self._planner.compute_action_to_pose(pos_w, q_w, speed, TURN_SPEED_RAD_S)
