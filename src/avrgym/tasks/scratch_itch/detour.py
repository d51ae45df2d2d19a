"""Extra path length of the tool around the arm in the task ScratchItch, for reward shaping.

An itch may be on the far side of a limb. A reward for a small straight distance then attracts the tool to the near
side. The tool gets stuck there. A hand without clearance gets stuck as well.
"""

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import get_namespace
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.scratch_itch import feedback_expert
from avrgym.tasks.scratch_itch.expert import ROD_DIRECTION, compute_skin_directions_w
from avrgym.tasks.scratch_itch.reward import ScratchItchState, compute_itch_limb_frame

MIN_LENGTH_M = 1e-4
TIP_TO_HAND_DISTANCE_M = 0.06
"""Distance of the robot's hand from the tip of the scratcher."""


def compute_limb_detour_m(state: State, task_state: ScratchItchState) -> FloatArray:
    """Returns the extra length (N,) in metres of the tool's path around the limb, compared with the straight path.

    The limb is modelled as an infinite cylinder with the itch on its surface. If the straight path intersects the
    cylinder, the shortest path follows a tangent and then the surface.
    """
    xp = get_namespace(state.tool_pos_w)
    limb_pos_w, limb_q_w = compute_itch_limb_frame(state, task_state)
    tool = transforms.rotate(transforms.conjugate(limb_q_w), state.tool_pos_w - limb_pos_w)
    along = tool[:, 2] - task_state.itch[:, 2]
    tool, itch = tool[:, :2], task_state.itch[:, :2]
    radius, from_axis = norm(itch), norm(tool)
    away = xp.maximum(from_axis, radius + MIN_LENGTH_M)
    cosine = (tool * itch).sum(axis=-1) / xp.maximum(from_axis * radius, MIN_LENGTH_M**2)
    angle = elementary.arccos(xp.clip(cosine, -1.0, 1.0))
    hidden = xp.maximum(angle - elementary.arccos(radius / away), 0.0)
    straight = norm(tool - itch)
    around = xp.where(hidden > 0.0, xp.sqrt(away**2 - radius**2) + radius * hidden, straight)
    return xp.hypot(around, along) - xp.hypot(straight, along)


def compute_tool_and_hand_detour_m(state: State, task_state: ScratchItchState) -> FloatArray:
    """Returns the extra path length (N,) in metres: of the tool around the limb, plus of the hand around the tip.

    ``feedback_expert`` defines the preferred direction of the hand.
    """
    _, limb_q_w = compute_itch_limb_frame(state, task_state)
    out_w, _ = compute_skin_directions_w(task_state, limb_q_w)
    turn_rad = feedback_expert.compute_hand_rotation_rad(
        transforms.rotate(state.tool_quat_w, ROD_DIRECTION), out_w
    )
    return compute_limb_detour_m(state, task_state) + TIP_TO_HAND_DISTANCE_M * norm(turn_rad)
