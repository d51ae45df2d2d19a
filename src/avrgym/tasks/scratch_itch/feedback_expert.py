"""Feedback expert for scratching: moves the tip around the arm to the itch. Its actions depend only on the current
state.
"""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing.expert import FOREARM
from avrgym.tasks.experts.feedback import ToolTarget, compute_standoff_m, compute_tool_speed_m_s
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.scratch_itch import expert
from avrgym.tasks.scratch_itch.reward import ScratchItchState, compute_itch_limb_frame, compute_itch_pos_w

BlendRange = tuple[float, float]

MAX_HAND_ANGLE_RAD = 1.2
"""Maximum angle between the preferred direction of the robot's hand and the skin normal."""
MAX_ROD_ANGLE_RAD = 0.4
"""Maximum angle between the scratcher's rod and the hand's direction."""
CLEARANCE_DIRECTION_FORWARD, CLEARANCE_DIRECTION_UP = -0.2, 0.2
"""Direction in which the hand has clearance: its components forward and up.

The component to the person's right is 1.
"""
SKIN_NORMAL_WEIGHT = 0.5
"""Weight of the skin normal in the hand's direction, see ``compute_hand_direction_w``."""
SIDE_CHANGE_NORMAL_Z = -0.35
"""Vertical component of the skin normal at which the robot's hand changes from above to below the arm."""
SIDE_CHANGE_TRANSITION_WIDTH = 0.17
"""Width of the transition at ``SIDE_CHANGE_NORMAL_Z``, in units of the vertical component."""
FRONT_DIRECTION_W = transforms.normalize(np.array([0.0, -0.7, 0.6]))
"""Direction with clearance for a hand in front of the person; world frame."""
FRONT_MAX_HAND_ANGLE_RAD = 1.0
"""Replaces ``MAX_HAND_ANGLE_RAD`` for a hand in front of the person."""
FRONT_MAX_ROD_ANGLE_RAD = 0.2
"""Replaces ``MAX_ROD_ANGLE_RAD`` for a hand in front of the person."""
INWARD_NORMAL_RANGE = (0.6, 0.85)
"""Range of the skin normal's x component in which the robot's hand changes to the front of the person. This skin faces
left.
"""
NOT_DOWNWARD_NORMAL_RANGE = (-0.5, -0.3)
"""Range of the skin normal's z component in which the robot's hand changes to the front of the person. This skin does
not face down.
"""
REMAINING_ROTATION_RANGE_RAD = (0.2, 0.6)
"""Range of the remaining rotation of a hand in front of the person.

Below the range the hand approaches the itch. Above the range it waits in front of the wrist.
"""
BLEND_WEIGHT_RANGE = (0.0, 1.0)
"""Minimum and maximum of the weight of an approach when two approaches are blended."""
MAX_LATERAL_OFFSET_M = 0.02
"""Maximum lateral offset from the itch at which the tip moves to the skin."""
MAX_LOOKAHEAD_ANGLE_RAD = 0.8
"""Largest angle around the limb between the tip and its target."""
RUB_SPEED_M_S = 0.06
"""Speed of the scratcher's tip on the skin."""
FORCE_CONTROL = expert.ForceControl(
    target_force_n=2.5, gain_m_per_n=0.0008, min_depth_step_m=-0.006, max_depth_step_m=0.001
)
"""Force control of the tip. The depth increases slowly and decreases quickly."""
MAX_LINK_FORCE_N = 5.0
"""Force of the links on the person above which the arm withdraws."""
WITHDRAWAL_DISTANCE_M = 0.03
"""Distance of the arm's withdrawal, see ``MAX_LINK_FORCE_N``."""
WITHDRAWAL_SPEED_M_S = 0.3
"""Speed of the arm's withdrawal, see ``MAX_LINK_FORCE_N``."""


def compute_scratching_target(
    state: State, task_state: ScratchItchState, planner: MotionPlanner
) -> ToolTarget:
    """Returns the next tool target: the tip moves around the limb above the skin to the itch, then rubs.

    For an itch on the inner side, a robot on the wheelchair first moves its hand to the person's wrist. In front of the
    wrist it rotates the hand. A robot on the floor does not do this, because its thicker arm would touch the person;
    see ``memory_expert``. If links press on the person, the arm withdraws.
    """
    out_w, _ = expert.compute_skin_directions_w(task_state, compute_itch_limb_frame(state, task_state)[1])
    return compute_blended_target(
        state,
        task_state,
        planner,
        compute_front_approach_weight(out_w) * (not planner.scene.mount.is_on_floor),
    )


def compute_blended_target(
    state: State, task_state: ScratchItchState, planner: MotionPlanner, in_front: FloatArray
) -> ToolTarget:
    """Returns the target of ``compute_scratching_target``. The approach from the front has the weight ``in_front``
    (N,), 0 to 1."""
    limb_pos_w, limb_q_w = compute_itch_limb_frame(state, task_state)
    out_w, _ = expert.compute_skin_directions_w(task_state, limb_q_w)
    rod_w = transforms.rotate(planner.tool_quat_w, expert.ROD_DIRECTION)
    turn_w = compute_hand_rotation_rad(rod_w, out_w, in_front)
    q_w = transforms.multiply(transforms.from_rotation_vector(turn_w), planner.tool_quat_w)
    tool = transforms.rotate(transforms.conjugate(limb_q_w), state.tool_pos_w - limb_pos_w)
    skin_w = limb_pos_w + transforms.rotate(limb_q_w, compute_tip_target_around_limb(tool, task_state))
    goal_w = expert.compute_tip_pos_w(skin_w, out_w, rod_w)
    waits = (in_front * np.interp(norm(turn_w), REMAINING_ROTATION_RANGE_RAD, BLEND_WEIGHT_RANGE))[:, None]
    goal_w = goal_w + waits * (state.right_arm_pos_w[:, 2] + expert.DETOUR_OFFSET_M - goal_w)
    itch_w = expert.compute_tip_pos_w(compute_itch_pos_w(state, task_state), out_w, rod_w)
    rubs = (state.tool_force_n > 0.0) & (norm(itch_w - state.tool_pos_w) < expert.CONTACT_SEARCH_DEPTH_M)
    rubbed_w = expert.compute_rubbing_target(state, task_state, planner.tool_pos_w, rod_w, FORCE_CONTROL)
    pos_w = np.where(rubs[:, None], rubbed_w, goal_w)
    speed = np.where(
        rubs, RUB_SPEED_M_S, compute_tool_speed_m_s(goal_w - state.tool_pos_w, expert.APPROACH_SPEED_M_S)
    )
    leans = state.links_force_n > MAX_LINK_FORCE_N
    pos_w = np.where(
        leans[:, None],
        planner.tool_pos_w + WITHDRAWAL_DISTANCE_M * compute_hand_direction_w(out_w, in_front),
        pos_w,
    )
    return (
        pos_w,
        np.where(leans[:, None], planner.tool_quat_w, q_w),
        np.where(leans, WITHDRAWAL_SPEED_M_S, speed),
    )


def compute_front_approach_weight(
    out_w: FloatArray,
    inwards: BlendRange = INWARD_NORMAL_RANGE,
    not_down: BlendRange = NOT_DOWNWARD_NORMAL_RANGE,
) -> FloatArray:
    """Returns the weight (N,) of the approach from the front, 0 to 1, for skin normals (N, 3) in the world frame.

    The weight is 0 or 1 for most normals.
    """
    return np.interp(out_w[:, 0], inwards, BLEND_WEIGHT_RANGE) * np.interp(
        out_w[:, 2], not_down, BLEND_WEIGHT_RANGE
    )


def compute_hand_rotation_rad(
    rod_w: FloatArray, out_w: FloatArray, in_front: FloatArray | float = 0.0
) -> FloatArray:
    """Returns rotation vectors (N, 3) in the world frame that rotate the rod until the hand has clearance.

    Args:
        rod_w: rod direction, unit vectors (N, 3), world frame.
        out_w: skin normal at the itch, unit vectors (N, 3), world frame.
        in_front: weight (N,) of the approach from the front, 0 to 1.
    """
    axis, angle = _turn(rod_w, -compute_hand_direction_w(out_w, in_front))
    askew_rad = MAX_ROD_ANGLE_RAD + in_front * (FRONT_MAX_ROD_ANGLE_RAD - MAX_ROD_ANGLE_RAD)
    return axis * get_namespace(angle).maximum(angle - askew_rad, 0.0)[:, None]


def compute_hand_direction_w(out_w: FloatArray, in_front: FloatArray | float = 0.0) -> FloatArray:
    """Returns the preferred direction (N, 3) of the hand from the itch, for skin normals (N, 3); world frame.

    This is the skin normal, rotated towards free space on the person's right. For skin that faces up it is also rotated
    forwards and upwards, for skin that faces down backwards and downwards. The share ``in_front`` (N,) rotates this
    direction to the front, over the lap.
    """
    xp = get_namespace(out_w)
    above = elementary.tanh((out_w[:, 2] - SIDE_CHANGE_NORMAL_Z) / SIDE_CHANGE_TRANSITION_WIDTH)
    right, forwards = (
        xp.ones_like(above),
        CLEARANCE_DIRECTION_FORWARD + SKIN_NORMAL_WEIGHT * (above - out_w[:, 1]),
    )
    room_w = xp.stack([-right, -forwards, CLEARANCE_DIRECTION_UP + SKIN_NORMAL_WEIGHT * above], axis=-1)
    share = (in_front + xp.zeros_like(above))[:, None]
    room_w = (1.0 - share) * transforms.normalize(room_w) + share * constant_like(FRONT_DIRECTION_W, out_w)
    axis, angle = _turn(out_w, room_w)
    slant_rad = MAX_HAND_ANGLE_RAD + in_front * (FRONT_MAX_HAND_ANGLE_RAD - MAX_HAND_ANGLE_RAD)
    return transforms.rotate(transforms.from_axis_angle(axis, xp.minimum(angle, slant_rad)), out_w)


def compute_tip_target_around_limb(tool: FloatArray, task_state: ScratchItchState) -> FloatArray:
    """Returns the next tip position (N, 3) in the limb's frame.

    The tip moves around the limb above the skin until it is at the itch.
    """
    radius = norm(task_state.itch[:, :2])
    now, there = (elementary.arctan2(place[:, 1], -place[:, 0]) for place in (tool, task_state.itch))
    shorter = (there - now + np.pi) % (2.0 * np.pi) - np.pi
    way = np.where(task_state.limb == FOREARM, shorter, there - now)
    beside = np.hypot(radius * way, task_state.itch[:, 2] - tool[:, 2])
    above = compute_standoff_m(beside, MAX_LATERAL_OFFSET_M, expert.STANDOFF_M)
    height = radius + np.where(above > 0.0, above, -expert.CONTACT_SEARCH_DEPTH_M)
    angle = now + np.clip(way, -MAX_LOOKAHEAD_ANGLE_RAD, MAX_LOOKAHEAD_ANGLE_RAD)
    return np.stack(
        [-height * elementary.cos(angle), height * elementary.sin(angle), task_state.itch[:, 2]], axis=-1
    )


def _turn(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns axis (N, 3) and angle (N,) of the rotation from vectors a to vectors b, (N, 3)."""
    axis = transforms.cross(a, b)
    sine = norm(axis)
    return axis / get_namespace(sine).maximum(sine, 1e-9)[:, None], elementary.arctan2(
        sine, (a * b).sum(axis=-1)
    )
