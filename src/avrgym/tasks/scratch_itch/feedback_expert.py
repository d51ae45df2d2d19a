"""The rule by which the reactive expert scratches: around the arm, wherever it itches."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, namespace
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing.expert import FOREARM
from avrgym.tasks.experts.feedback import ToolTarget, speed_m_s, standoff_m
from avrgym.tasks.experts.motion_planner import MotionPlanner
from avrgym.tasks.scratch_itch import expert
from avrgym.tasks.scratch_itch.reward import ScratchItchState, itch_pos_w, limb_frame

Range = tuple[float, float]

SLANT_RAD, ASKEW_RAD = 1.2, 0.4
"""How far from straight out of the skin the hand may be drawn, and how far the rod may point beside it."""
FORWARDS, UPWARDS, SWERVE = -0.2, 0.2, 0.5
"""Where the hand has room, for each metre to the person's right; and how much more so by how the skin lies there."""
LEVEL, SOFT = -0.35, 0.17
"""The height of the skin's normal at which the hand changes from above the arm to below it, and how gradually."""
FRONT_W = transforms.normalize(np.array([0.0, -0.7, 0.6]))
FRONT_SLANT_RAD, FRONT_ASKEW_RAD = 1.0, 0.2
"""Where a hand has room that comes from in front, and what ``SLANT_RAD`` and ``ASKEW_RAD`` are for it."""
INWARDS, NOT_DOWN = (0.6, 0.85), (-0.5, -0.3)
"""Skin is scratched from in front that faces the person's left, and not the ground: from where on, and from where on
wholly, as parts of its normal."""
STILL_TURNS_RAD = (0.2, 0.6)
"""Such a hand comes to the itch when it has to turn by no more than the first; from the second on it waits before the
wrist."""
NONE_TO_ALL = (0.0, 1.0)
"""The shares at the first and the second of two such values; evenly more between them."""
BESIDE_M = 0.02
"""How far beside the itch the tip comes down."""
AHEAD_RAD = 0.8
"""How far around the limb the tip aims at most."""
RUB_M_S = 0.06
PRESS = expert.Press(force_n=2.5, m_per_n=0.0008, softer_m=-0.006, firmer_m=0.001)
"""How fast it rubs and how hard: so slowly that the force hardly swings, and quick to give way."""
LEANING_N, BACK_M, BACK_M_S = 5.0, 0.03, 0.3
"""From what force of its links on the person an arm draws back, how far in a control step it aims, and how fast."""


def scratching_target(state: State, task_state: ScratchItchState, planner: MotionPlanner) -> ToolTarget:
    """The tip goes around the limb above the skin and comes down at the itch; where it touches, it rubs.

    Where it itches on the inner side, an arm that is mounted on the wheelchair first turns its hand before the wrist.
    The thicker one that stands on the floor would lean on the person: see ``patient``. An arm that leans draws back,
    out to where its hand has room.
    """
    out_w, _ = expert.surface(task_state, limb_frame(state, task_state)[1])
    return aim(state, task_state, planner, faces_in(out_w) * (not planner.scene.mount.on_floor))


def aim(
    state: State, task_state: ScratchItchState, planner: MotionPlanner, in_front: FloatArray
) -> ToolTarget:
    """Where tips go as in ``scratching_target``, of hands that come by a share (N,) from in front."""
    limb_pos_w, limb_q_w = limb_frame(state, task_state)
    out_w, _ = expert.surface(task_state, limb_q_w)
    rod_w = transforms.rotate(planner.q_w, expert.ROD)
    turn_w = turn_rad(rod_w, out_w, in_front)
    q_w = transforms.multiply(transforms.from_rotation_vector(turn_w), planner.q_w)
    tool = transforms.rotate(transforms.conjugate(limb_q_w), state.tool_pos_w - limb_pos_w)
    skin_w = limb_pos_w + transforms.rotate(limb_q_w, around(tool, task_state))
    goal_w = expert.tip(skin_w, out_w, rod_w)
    waits = (in_front * np.interp(norm(turn_w), STILL_TURNS_RAD, NONE_TO_ALL))[:, None]
    goal_w = goal_w + waits * (state.right_arm_pos_w[:, 2] + expert.FROM_WRIST_M - goal_w)
    itch_w = expert.tip(itch_pos_w(state, task_state), out_w, rod_w)
    rubs = (state.tool_force_n > 0.0) & (norm(itch_w - state.tool_pos_w) < expert.SEEK_DEPTH_M)
    rubbed_w = expert.rub(state, task_state, planner.pos_w, rod_w, PRESS)
    pos_w = np.where(rubs[:, None], rubbed_w, goal_w)
    speed = np.where(rubs, RUB_M_S, speed_m_s(goal_w - state.tool_pos_w, expert.ENTER_M_S))
    leans = state.links_force_n > LEANING_N
    pos_w = np.where(leans[:, None], planner.pos_w + BACK_M * hand(out_w, in_front), pos_w)
    return pos_w, np.where(leans[:, None], planner.q_w, q_w), np.where(leans, BACK_M_S, speed)


def faces_in(out_w: FloatArray, inwards: Range = INWARDS, not_down: Range = NOT_DOWN) -> FloatArray:
    """What share (N,) of skin that faces (N, 3), world frame, is to be reached from in front: none or all, mostly."""
    return np.interp(out_w[:, 0], inwards, NONE_TO_ALL) * np.interp(out_w[:, 2], not_down, NONE_TO_ALL)


def turn_rad(rod_w: FloatArray, out_w: FloatArray, in_front: FloatArray | float = 0.0) -> FloatArray:
    """How a rod has to turn, rotation vectors (N, 3), world frame, for the hand to be where it has room.

    Args:
        rod_w: where it points, unit vectors (N, 3), world frame.
        out_w: out of the skin at the itch, likewise.
        in_front: see ``hand``.
    """
    axis, angle = _turn(rod_w, -hand(out_w, in_front))
    askew_rad = ASKEW_RAD + in_front * (FRONT_ASKEW_RAD - ASKEW_RAD)
    return axis * namespace(angle).maximum(angle - askew_rad, 0.0)[:, None]


def hand(out_w: FloatArray, in_front: FloatArray | float = 0.0) -> FloatArray:
    """In which direction (N, 3) from an itch the hand should be, world frame, by where its skin faces (N, 3).

    Straight out of the skin, but drawn to where there is room: on the person's right, in front and above where the skin
    faces up, behind and below where it faces down; by a share (N,) it comes from in front, over the lap.
    """
    xp = namespace(out_w)
    above = elementary.tanh((out_w[:, 2] - LEVEL) / SOFT)
    right, forwards = xp.ones_like(above), FORWARDS + SWERVE * (above - out_w[:, 1])
    room_w = xp.stack([-right, -forwards, UPWARDS + SWERVE * above], axis=-1)
    share = (in_front + xp.zeros_like(above))[:, None]
    room_w = (1.0 - share) * transforms.normalize(room_w) + share * constant_like(FRONT_W, out_w)
    axis, angle = _turn(out_w, room_w)
    slant_rad = SLANT_RAD + in_front * (FRONT_SLANT_RAD - SLANT_RAD)
    return transforms.rotate(transforms.from_axis_angle(axis, xp.minimum(angle, slant_rad)), out_w)


def around(tool: FloatArray, task_state: ScratchItchState) -> FloatArray:
    """Where a tip (N, 3) goes next (N, 3), limb's frame: around it, above the skin until it is at the itch."""
    radius = norm(task_state.itch[:, :2])
    now, there = (elementary.arctan2(place[:, 1], -place[:, 0]) for place in (tool, task_state.itch))
    shorter = (there - now + np.pi) % (2.0 * np.pi) - np.pi
    way = np.where(task_state.limb == FOREARM, shorter, there - now)
    beside = np.hypot(radius * way, task_state.itch[:, 2] - tool[:, 2])
    above = standoff_m(beside, BESIDE_M, expert.AWAY_M)
    height = radius + np.where(above > 0.0, above, -expert.SEEK_DEPTH_M)
    angle = now + np.clip(way, -AHEAD_RAD, AHEAD_RAD)
    return np.stack(
        [-height * elementary.cos(angle), height * elementary.sin(angle), task_state.itch[:, 2]], axis=-1
    )


def _turn(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The axis (N, 3) about which vectors a turn to vectors b, (N, 3), and by how much (N,)."""
    axis = transforms.cross(a, b)
    sine = norm(axis)
    return axis / namespace(sine).maximum(sine, 1e-9)[:, None], elementary.arctan2(sine, (a * b).sum(axis=-1))
