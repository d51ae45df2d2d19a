"""What training counts beyond a task's own reward, so that a policy is drawn the way that leads to the goal.

A reward that falls with the straight distance draws a tool to the near side of a limb that itches on its far side, and
there it stays. So it is with a hand that is where it has no room.
"""

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import namespace
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.scratch_itch import feedback_expert
from avrgym.tasks.scratch_itch.expert import ROD, surface
from avrgym.tasks.scratch_itch.reward import ScratchItchState, limb_frame

SMALLEST_M = 1e-4
HAND_M = 0.06
"""How far from the tip the hand begins."""


def around_limb_m(state: State, task_state: ScratchItchState) -> FloatArray:
    """How much longer the tool's way to the itch is around the limb than straight on, (N,), metres.

    The limb is an endless cylinder with the itch on its skin. Where the straight way would lead through it, the
    shortest one leads along a tangent to the skin and then around it; unrolled it is straight.
    """
    xp = namespace(state.tool_pos_w)
    limb_pos_w, limb_q_w = limb_frame(state, task_state)
    tool = transforms.rotate(transforms.conjugate(limb_q_w), state.tool_pos_w - limb_pos_w)
    along = tool[:, 2] - task_state.itch[:, 2]
    tool, itch = tool[:, :2], task_state.itch[:, :2]
    radius, from_axis = norm(itch), norm(tool)
    away = xp.maximum(from_axis, radius + SMALLEST_M)
    cosine = (tool * itch).sum(axis=-1) / xp.maximum(from_axis * radius, SMALLEST_M**2)
    angle = elementary.arccos(xp.clip(cosine, -1.0, 1.0))
    hidden = xp.maximum(angle - elementary.arccos(radius / away), 0.0)
    straight = norm(tool - itch)
    around = xp.where(hidden > 0.0, xp.sqrt(away**2 - radius**2) + radius * hidden, straight)
    return xp.hypot(around, along) - xp.hypot(straight, along)


def around_arm_m(state: State, task_state: ScratchItchState) -> FloatArray:
    """How much longer the way around the limb is, (N,), metres, and how far the hand has to go about the tip.

    The hand is to be where it has room, as in ``reactive``.
    """
    _, limb_q_w = limb_frame(state, task_state)
    out_w, _ = surface(task_state, limb_q_w)
    turn_rad = feedback_expert.turn_rad(transforms.rotate(state.tool_q_w, ROD), out_w)
    return around_limb_m(state, task_state) + HAND_M * norm(turn_rad)
