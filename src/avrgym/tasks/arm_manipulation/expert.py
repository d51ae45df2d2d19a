"""Expert for arm manipulation. Its actions depend only on the current state. Policies without memory can therefore
imitate it.
"""

from functools import partial

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models.furniture.wheelchair import ARMREST_TOP_HEIGHT_M
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import RightArmPoses, State
from avrgym.tasks.arm_manipulation.reward import (
    ELBOW_INDEX,
    RESTING_FOREARM_X_M,
    ArmManipulationState,
    compute_forearm_up_direction_w,
    compute_lifted_point_w,
)
from avrgym.tasks.experts.feedback import (
    FeedbackExpert,
    ToolTarget,
    compute_standoff_m,
    compute_tool_speed_m_s,
)
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.task import Controller, RunningEpisodes

CONTACT_OFFSET_M, MAX_STANDOFF_M, FREE_LATERAL_OFFSET_M, ALONG_FOREARM_WEIGHT = 0.045, 0.08, 0.025, 0.4
"""Distances of the scooper from the forearm.

In contact, the scooper is ``CONTACT_OFFSET_M`` below the forearm's axis. Before contact, its target is up to
``MAX_STANDOFF_M`` lower if its lateral offset exceeds ``FREE_LATERAL_OFFSET_M``. ``ALONG_FOREARM_WEIGHT`` is the weight
of offsets along the forearm.
"""
CRADLED_HEIGHT_M, RIM_CONTACT_HEIGHT_M = 0.06, 0.08
"""Heights of the forearm's axis above the scooper.

At ``CRADLED_HEIGHT_M`` the forearm is between the rims. At ``RIM_CONTACT_HEIGHT_M`` it may be on a rim. Between these
heights, the lateral motion decreases to zero.
"""
CARRYING_HEIGHT_M = ARMREST_TOP_HEIGHT_M + CONTACT_OFFSET_M + 0.03
"""Height of the forearm's axis at which the scooper passes over the armrest."""
LIFT_HEIGHT_TOLERANCE_M = 0.03
"""Maximum distance of the forearm below the carrying height at which the scooper also moves it to the person's left."""
FOREARM_GOAL_OFFSET_M = 0.06
"""Distance of the forearm's goal from the middle of the armrest, to the person's left."""
MIN_LIFTED_POINT_X_M = RESTING_FOREARM_X_M - 0.145
"""Minimum x coordinate of the forearm's lifted point during lifting. At this coordinate, the far rim of the scooper
does not touch the armrest.
"""
MAX_VERTICAL_LEAD_M, HEIGHT_MARGIN_M, LIFT_SPEED_M_S, MIN_SPEED_M_S = 0.05, 0.06, 0.12, 0.02
"""First, the maximum vertical distance of the scooper's target from the forearm. Second, the height of the target above
the carrying height.

Third and fourth, the maximum and minimum speed of the scooper.
"""


def compute_handle_direction_w(scene: SceneConfig) -> FloatArray:
    """Returns the direction (3,) of the scooper's handle in the world frame, from the robot's hand to the trough."""
    return np.array([1.0, -0.4, 0.0] if scene.mount.is_on_floor else [1.0, 0.0, 0.0])


def compute_scooper_quat_w(arm: RightArmPoses, heading: FloatArray) -> FloatArray:
    """Returns the rotation (N, 4) of a scooper below the forearm, with its handle along ``heading`` (3,)."""
    z_w = compute_forearm_up_direction_w(arm)
    ahead = constant_like(heading, z_w)
    x_w = transforms.normalize(ahead - z_w * (z_w * ahead).sum(axis=-1)[:, None])
    return transforms.from_matrix(get_namespace(z_w).stack([x_w, transforms.cross(z_w, x_w), z_w], axis=-1))


def make_lifting_expert(episodes: RunningEpisodes) -> Controller:
    """Returns the expert for the robot of ``episodes``. The robot determines the direction of the scooper's handle."""
    return FeedbackExpert(
        episodes, partial(compute_lifting_target, heading=compute_handle_direction_w(episodes.scene))
    )


def compute_lifting_target(
    state: State, task_state: ArmManipulationState, planner: MotionPlanner, heading: FloatArray
) -> ToolTarget:
    """Returns the next tool target: below the forearm, then upwards, then to the person's left."""
    up_w, lifted_w = compute_forearm_up_direction_w(state), compute_lifted_point_w(state)
    before = compute_standoff_m(_beside_m(state), FREE_LATERAL_OFFSET_M, MAX_STANDOFF_M)
    missing = CARRYING_HEIGHT_M - lifted_w[:, 2]
    carries = np.clip(1.0 - missing / LIFT_HEIGHT_TOLERANCE_M, 0.0, 1.0)
    goal_w = lifted_w - (CONTACT_OFFSET_M + before)[:, None] * up_w
    below = np.clip(1.0 - before / LIFT_HEIGHT_TOLERANCE_M, 0.0, 1.0)
    goal_w[:, 2] += below * np.clip(missing + HEIGHT_MARGIN_M, -MAX_VERTICAL_LEAD_M, MAX_VERTICAL_LEAD_M)
    aim_x = MIN_LIFTED_POINT_X_M + carries * (
        RESTING_FOREARM_X_M + FOREARM_GOAL_OFFSET_M - MIN_LIFTED_POINT_X_M
    )
    above_m = ((lifted_w - state.tool_pos_w) * up_w).sum(axis=-1)
    cradled = np.clip((RIM_CONTACT_HEIGHT_M - above_m) / (RIM_CONTACT_HEIGHT_M - CRADLED_HEIGHT_M), 0.0, 1.0)
    goal_w[:, 0] += cradled * below * np.clip(aim_x - lifted_w[:, 0], 0.0, 2.0 * MAX_VERTICAL_LEAD_M)
    goal_w[:, 2] = np.minimum(goal_w[:, 2], CARRYING_HEIGHT_M + HEIGHT_MARGIN_M - CONTACT_OFFSET_M)
    speed = np.minimum(compute_tool_speed_m_s(goal_w - state.tool_pos_w, MIN_SPEED_M_S), LIFT_SPEED_M_S)
    return goal_w, compute_scooper_quat_w(state, heading), speed


def _beside_m(state: State) -> FloatArray:
    """Returns the distance (N,) of the scooper from the forearm's lifted point, without the component along
    ``compute_forearm_up_direction_w``.

    Offsets along the forearm have the weight ``ALONG_FOREARM_WEIGHT``, because the scooper slides along the forearm.
    """
    offset = state.tool_pos_w - compute_lifted_point_w(state)
    along_w = transforms.rotate(state.right_arm_quat_w[:, ELBOW_INDEX], (0.0, 0.0, 1.0))
    along, up = (
        (offset * axis).sum(axis=-1)[:, None] * axis
        for axis in (along_w, compute_forearm_up_direction_w(state))
    )
    return transforms.norm(offset - up - (1.0 - ALONG_FOREARM_WEIGHT) * along)
