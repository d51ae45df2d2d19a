"""How simulated people move who cooperate with a robot, as participants do (paper, section V).

They see the tool as it was a reaction time ago. Whoever is fed or given a drink turns the face to the tool and
leans towards it when it is near; whoever is scratched or wiped lifts the arm towards it and holds it there. All
sway a little. The numbers are our assumptions about unhurried adults: reactions of 0.2 to 0.4 s, slow turns,
sway below 0.5 Hz.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import constant_like, float_copy, interpolate, namespace, row_indices
from avrgym.models import human
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Posture
from avrgym.models.scene import CONTROL_STEP_S

OfferedPart = Literal["mouth", "arm", "nothing"]


class PersonObservation(Protocol):
    """What N people see and feel of the tool and of themselves, as in ``simulation.worlds.State``; world frame."""

    @property
    def tool_pos_w(self) -> FloatArray:
        """The tool, (N, 3)."""
        ...

    @property
    def head_pos_w(self) -> FloatArray:
        """The head's centre, (N, 3)."""
        ...

    @property
    def mouth_pos_w(self) -> FloatArray:
        """The mouth, (N, 3)."""
        ...

    @property
    def right_arm_pos_w(self) -> FloatArray:
        """Shoulder, elbow and wrist, (N, 3, 3)."""
        ...


NUM_UNIFORMS = 6
"""How many uniform numbers a person's manner takes."""

REMEMBERED_STEPS = 5
REACTION_STEPS = (2, 4)
FACING_SHARE = (0.3, 0.7)
SWAY_RAD = (float(np.radians(0.3)), float(np.radians(1.0)))
SWAY_HZ = (0.1, 0.3)

NEAR_MOUTH_M, LEAN_RAD = 0.30, float(np.radians(10.0))
NEAR_ARM_M, LIFT_RAD = 0.40, float(np.radians(8.0))
HEAD_TURN_RAD = np.radians([30.0, 0.0, 40.0])
SPEED_RAD_S = np.array(
    [{"torso": 0.2, "head": 0.8}.get(joint.body, 0.4) for joint in JOINTS.values()], dtype=float
)

OFFERED_JOINTS: Mapping[OfferedPart, tuple[str, ...]] = {
    "mouth": tuple(name for name, joint in JOINTS.items() if joint.body in ("torso", "head")),
    "arm": tuple(name for name in JOINTS if name.startswith("right_")),
    "nothing": (),
}
"""The joints with which people bring the tool what they offer."""

_WAIST_X, _WAIST_Y = JOINT_INDEX["waist_x"], JOINT_INDEX["waist_y"]
_HEAD = np.array([JOINT_INDEX[f"head_{axis}"] for axis in "xyz"])
_LIFT = np.array([JOINT_INDEX["right_shoulder_y"], JOINT_INDEX["right_elbow_x"]])


@dataclass(frozen=True)
class CooperationState:
    """What N cooperating people carry from one control step to the next.

    ``seen_w`` (N, ``REMEMBERED_STEPS``, 3) are the latest places of the tool, newest first; ``targets_rad``
    (N, 20) the joints' targets without sway, ``rest_rad`` (N, 20) where they began; ``time_s`` (N,) since then.
    The rest, (N,) each, is their manner: reaction in control steps, how far they turn to the tool, sway and its
    phases (N, 2).
    """

    seen_w: FloatArray
    targets_rad: FloatArray
    rest_rad: FloatArray
    time_s: FloatArray
    reaction: IntArray
    facing: FloatArray
    sway_rad: FloatArray
    sway_hz: FloatArray
    phase_rad: FloatArray


def initial_state(people: People, uniforms: FloatArray) -> CooperationState:
    """The minds of people whose episode begins, from uniform numbers (n, ``NUM_UNIFORMS``)."""
    xp, count = namespace(uniforms), len(uniforms)
    low, high = REACTION_STEPS
    return CooperationState(
        seen_w=xp.full((count, REMEMBERED_STEPS, 3), xp.inf, dtype=uniforms.dtype, device=uniforms.device),
        targets_rad=people.joint_angles_rad,
        rest_rad=people.joint_angles_rad,
        time_s=xp.zeros_like(uniforms[:, 0]),
        reaction=xp.minimum(low + xp.astype((high - low + 1) * uniforms[:, 0], xp.int64), high),
        facing=interpolate(FACING_SHARE, uniforms[:, 1]),
        sway_rad=interpolate(SWAY_RAD, uniforms[:, 2]),
        sway_hz=interpolate(SWAY_HZ, uniforms[:, 3]),
        phase_rad=2.0 * np.pi * uniforms[:, 4:6],
    )


def update_targets(
    mind: CooperationState, sight: PersonObservation, offered: OfferedPart, posture: Posture
) -> CooperationState:
    """They see the tool, and their targets move.

    Args:
        mind: what they carry.
        sight: what they see now.
        offered: what they bring to the tool.
        posture: how they sit or lie.
    """
    xp = namespace(mind.targets_rad)
    seen = xp.concat([sight.tool_pos_w[:, None], mind.seen_w[:, :-1]], axis=1)
    tool = seen[row_indices(seen), mind.reaction]
    match offered:
        case "mouth":
            wanted = _mouth_targets(mind, sight, tool, posture)
        case "arm":
            wanted = _arm_targets(mind, sight, tool)
        case "nothing":
            wanted = mind.targets_rad
    reach = constant_like(SPEED_RAD_S * CONTROL_STEP_S, mind.targets_rad)
    moved = mind.targets_rad + xp.clip(wanted - mind.targets_rad, -reach, reach)
    return replace(mind, seen_w=seen, targets_rad=moved)


def advance_time(mind: CooperationState) -> CooperationState:
    """One control step passes."""
    return replace(mind, time_s=mind.time_s + CONTROL_STEP_S)


def sway_rad(mind: CooperationState) -> FloatArray:
    """What sway adds to the joints' targets (N, 20): the waist rocks to and fro and to the sides."""
    xp = namespace(mind.targets_rad)
    angle = 2.0 * np.pi * mind.sway_hz * mind.time_s
    phase = mind.phase_rad[:, :2].T
    swung = elementary.sin(xp.stack([angle, 0.7 * angle]) + phase) - elementary.sin(phase)
    wave = xp.zeros_like(mind.targets_rad)
    wave[:, _WAIST_X], wave[:, _WAIST_Y] = mind.sway_rad * swung[0], mind.sway_rad * swung[1]
    return wave


def _mouth_targets(
    mind: CooperationState, sight: PersonObservation, tool_w: FloatArray, posture: Posture
) -> FloatArray:
    """Targets that turn the face to the tool, and lean to it when it is near and in front."""
    xp, most, head = namespace(tool_w), constant_like(HEAD_TURN_RAD, tool_w), constant_like(_HEAD, tool_w)
    seen = xp.isfinite(tool_w).all(axis=-1)
    offset = xp.where(seen[:, None], tool_w, sight.mouth_pos_w) - sight.head_pos_w
    ahead = in_torso_frame(mind.targets_rad, offset, posture)
    turn = xp.clip(mind.facing[:, None] * head_angles_toward(ahead), -most, most)
    near = seen & (transforms.norm(ahead) < NEAR_MOUTH_M) & (ahead[:, 1] < 0.0)
    wanted = float_copy(mind.targets_rad)
    wanted[:, head] = xp.where(seen[:, None], turn, wanted[:, head])
    wanted[:, _WAIST_X] = xp.where(near, LEAN_RAD, wanted[:, _WAIST_X])
    return wanted


def _arm_targets(mind: CooperationState, sight: PersonObservation, tool_w: FloatArray) -> FloatArray:
    """Targets that lift the right arm sideways and stretch it a little when the tool is near."""
    xp, lift = namespace(tool_w), constant_like(_LIFT, tool_w)
    gap = xp.min(transforms.norm(sight.right_arm_pos_w - tool_w[:, None]), axis=-1)
    lifted = mind.rest_rad[:, lift] + LIFT_RAD
    wanted = float_copy(mind.targets_rad)
    wanted[:, lift] = xp.where((gap < NEAR_ARM_M)[:, None], lifted, wanted[:, lift])
    return wanted


def in_torso_frame(joint_angles_rad: FloatArray, offset_w: FloatArray, posture: Posture) -> FloatArray:
    """Offsets (N, 3), world frame, in the torso's frame of people with joint angles (N, 20): ahead is −y."""
    hips, torso = (human.body_rotation(body, joint_angles_rad, posture) for body in ("hips", "torso"))
    return transforms.rotate(transforms.conjugate(transforms.multiply(hips, torso)), offset_w)


def head_angles_toward(ahead: FloatArray) -> FloatArray:
    """The head's joint angles (N, 3) that turn the face to what lies there from the head (N, 3), torso's frame."""
    xp = namespace(ahead)
    facing = xp.zeros_like(ahead)
    facing[:, 0] = elementary.arctan2(-ahead[:, 2], -ahead[:, 1])
    distance = xp.maximum(transforms.norm(ahead), 1e-9)
    facing[:, 2] = elementary.arcsin(xp.clip(ahead[:, 0] / distance, -1.0, 1.0))
    return facing
