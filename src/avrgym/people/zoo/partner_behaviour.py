"""How partners of the zoo move: what their traits make of what they see, as fast and as suddenly as people do.

Posture follows what they want with bounded speed and acceleration; sway, chewing and tremor come on top. All of it is
smooth: servos go evenly from one control step's target to the next, see ``Simulation.command_person``.

What unhurried people do at most:

- head 1.2 rad/s, less than the 1.6 that heads reach as people walk or run, and 8 rad/s², a quarter of what that is at
  the 3.2 Hz of running (Grossman et al., Exp. Brain Res. 70:470, 1988);
- arms 0.8 rad/s, less than the 1.2 of a hand that reaches for a glass at 0.66 m/s on an arm of 0.55 m (de los
  Reyes-Guzmán et al., J. NeuroEng. Rehabil. 7:41, 2010), and 3.5 rad/s², that of the same reach, which takes 1.04 s,
  with minimum jerk (Flash and Hogan, J. Neurosci. 5:1688, 1985);
- waist 0.35 rad/s and 2 rad/s², our assumption.

Who is startled turns the head with up to 3 rad/s and 30 rad/s², where vigorous turning reaches 13.6 rad/s at 2.6 Hz
(Grossman et al.), and moves all else 2.5 times as fast as usual.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import RAD_PER_DEGREE, constant_like, float_copy, namespace, row_indices
from avrgym.models.human import JOINT_INDEX, JOINTS, People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import cooperation
from avrgym.people.cooperation import (
    HEAD_TURN_RAD,
    LEAN_RAD,
    LIFT_RAD,
    NEAR_ARM_M,
    NEAR_MOUTH_M,
    OfferedPart,
    PersonObservation,
)
from avrgym.people.zoo.partners import PARTNER_PARAMETERS, BehaviourParameters

JointLimiter = Callable[[FloatArray], FloatArray]
"""Brings joint angles (N, 20) to where these people's joints can go."""

REMEMBERED_STEPS = 11
"""Of the tool's places: a second and the present."""
SPEED_RAD_S = np.array([{"torso": 0.35, "head": 1.2}.get(each.body, 0.8) for each in JOINTS.values()])
ACCELERATION_RAD_S2 = np.array([{"torso": 2.0, "head": 8.0}.get(each.body, 3.5) for each in JOINTS.values()])
STARTLE_SPEED_FACTOR, STARTLE_ACCELERATION_FACTOR = 2.5, 3.75
"""By how much faster, and more suddenly, the startled move."""
STARTLE_INTERVAL_S = 3.0
"""So long after a startle nobody is startled again."""
NEVER_S = 1e6
ONSET_S = 1.0
"""How long sway, chewing and tremor take to come to their full extent."""
GOLDEN_RATIO_FRACTION = 0.6180339887498949
"""Multiples of it, without their whole parts, are spread evenly (Weyl): one after the other they serve as chance."""

_WAIST = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
_HEAD = np.array([JOINT_INDEX[f"head_{axis}"] for axis in "xyz"])
_SHOULDER, _ELBOW = JOINT_INDEX["right_shoulder_y"], JOINT_INDEX["right_elbow_x"]


@dataclass(frozen=True)
class PartnerState:
    """What N partners carry from one control step to the next.

    ``partner`` (N,) are rows of ``PARTNER_PARAMETERS``, ``chance`` (N, 4) numbers in 0..1 that tell partners alike
    apart. ``seen_w`` (N, ``REMEMBERED_STEPS``, 3) are the latest places of the tool, newest first. ``rest_rad``,
    ``targets_rad`` and ``speed_rad_s`` (N, 20): where the joints began, where they are to be without sway, chewing and
    tremor, and how fast they go there. ``time_s`` (N,) since the start, ``near_s`` since the tool came near, 0 while it
    is not, ``startled_s`` since the latest of ``startles``.
    """

    partner: IntArray
    chance: FloatArray
    seen_w: FloatArray
    rest_rad: FloatArray
    targets_rad: FloatArray
    speed_rad_s: FloatArray
    time_s: FloatArray
    near_s: FloatArray
    startled_s: FloatArray
    startles: FloatArray


class _ToolPercept(NamedTuple):
    """The tool as N people are aware of it: whether they are, the face's angles to it (N, 3), how far it is from what
    they offer (N,), and on which side of them, 1 for the left and −1 for the right."""

    aware: BoolArray
    facing_rad: FloatArray
    gap_m: FloatArray
    side: FloatArray


def initial_state(people: People, partners: IntArray, chance: FloatArray) -> PartnerState:
    """The minds of partners (n,) in the bodies of people whose episode begins, from uniform numbers (n, 4)."""
    xp = namespace(chance)
    at_rest, none = xp.zeros_like(people.joint_angles_rad), xp.zeros_like(chance[:, 0])
    return PartnerState(
        partner=partners,
        chance=chance,
        seen_w=xp.zeros((len(chance), REMEMBERED_STEPS, 3), dtype=chance.dtype, device=chance.device),
        rest_rad=people.joint_angles_rad,
        targets_rad=people.joint_angles_rad,
        speed_rad_s=at_rest,
        time_s=none,
        near_s=none,
        startled_s=xp.full_like(none, NEVER_S),
        startles=none,
    )


def step(
    mind: PartnerState,
    sight: PersonObservation,
    offered: OfferedPart,
    posture: Posture,
    possible: JointLimiter,
) -> PartnerState:
    """One control step passes: they look, and their targets move.

    Args:
        mind: what they carry.
        sight: what they see now.
        offered: what they bring to the tool.
        posture: how they sit or lie.
        possible: where their joints can go.
    """
    manner = PARTNER_PARAMETERS.of(mind.partner, mind.time_s)
    seen = namespace(mind.seen_w).concat([sight.tool_pos_w[:, None], mind.seen_w[:, :-1]], axis=1)
    mind = replace(mind, seen_w=seen, time_s=mind.time_s + CONTROL_STEP_S)
    view = _perceive_tool(mind, manner, sight, offered, posture)
    mind = _update_startle(mind, manner, view, offered)
    return _track(mind, manner, possible(_desired_angles(mind, manner, view, offered)))


def steer_targets(targets_rad: FloatArray, joints: Sequence[str], action: FloatArray) -> FloatArray:
    """Targets (N, 20) a control step on, of joints that go at shares (N, K) of the speed of unhurried people."""
    columns = np.array([JOINT_INDEX[name] for name in joints], dtype=np.intp)
    targets = float_copy(targets_rad)
    reach = constant_like(CONTROL_STEP_S * SPEED_RAD_S[columns], targets)
    targets[:, constant_like(columns, targets)] += reach * namespace(action).clip(action, -1.0, 1.0)
    return targets


def oscillation_rad(mind: PartnerState) -> FloatArray:
    """What sway and chewing add to the joints' targets (N, 20): nothing at first."""
    xp, manner = namespace(mind.targets_rad), PARTNER_PARAMETERS.of(mind.partner, mind.time_s)
    wave = xp.zeros_like(mind.targets_rad)
    phase = 2.0 * np.pi * mind.chance[:, :2].T
    angle = 2.0 * np.pi * manner.sway_hz * mind.time_s
    swung = elementary.sin(xp.stack([angle, 0.7 * angle]) + phase) - elementary.sin(phase)
    extent = RAD_PER_DEGREE * manner.sway_deg
    wave[:, _WAIST[0]], wave[:, _WAIST[1]] = extent * swung[0], extent * swung[1]
    opened = 0.5 - 0.5 * elementary.cos(2.0 * np.pi * manner.chew_hz * mind.time_s)
    wave[:, _HEAD[0]] = -(RAD_PER_DEGREE * manner.chew_deg) * opened * onset_share(mind)
    return wave


def onset_share(mind: PartnerState) -> FloatArray:
    """What share (N,) of their full extent chewing and tremor have come to."""
    return namespace(mind.time_s).minimum(mind.time_s / ONSET_S, 1.0)


def _perceive_tool(
    mind: PartnerState,
    manner: BehaviourParameters,
    sight: PersonObservation,
    offered: OfferedPart,
    posture: Posture,
) -> _ToolPercept:
    """The tool's place of a reaction time ago, between two that they remember, and what it is to them."""
    xp = namespace(mind.time_s)
    back = manner.reaction_s / CONTROL_STEP_S
    whole = xp.astype(back, xp.int64)
    share, row = (back - whole)[:, None], row_indices(back)
    tool = (1.0 - share) * mind.seen_w[row, whole] + share * mind.seen_w[row, whole + 1]
    aware = mind.time_s > manner.reaction_s + 1.5 * CONTROL_STEP_S
    tool = xp.where(aware[:, None], tool, sight.mouth_pos_w)
    ahead = cooperation.in_torso_frame(mind.targets_rad, tool - sight.head_pos_w, posture)
    match offered:
        case "mouth":
            gap = xp.where(ahead[:, 1] < 0.0, transforms.norm(tool - sight.mouth_pos_w), np.inf)
        case "arm":
            gap = xp.min(transforms.norm(sight.right_arm_pos_w - tool[:, None]), axis=-1)
        case "nothing":
            gap = xp.full_like(back, xp.inf)
    side = xp.where(ahead[:, 0] > 0.0, 1.0, -1.0)
    return _ToolPercept(aware, cooperation.head_angles_toward(ahead), xp.where(aware, gap, np.inf), side)


def _update_startle(
    mind: PartnerState, manner: BehaviourParameters, view: _ToolPercept, offered: OfferedPart
) -> PartnerState:
    """For how long the tool has been near, and whether that startles them."""
    xp = namespace(view.gap_m)
    near = view.gap_m < (NEAR_ARM_M if offered == "arm" else NEAR_MOUTH_M)
    startled = (manner.startle_deg > 0.0) & (view.gap_m < manner.startle_m)
    startled &= mind.startled_s > manner.startle_s + STARTLE_INTERVAL_S
    return replace(
        mind,
        near_s=xp.where(near, mind.near_s + CONTROL_STEP_S, 0.0),
        startled_s=xp.where(startled, 0.0, mind.startled_s + CONTROL_STEP_S),
        startles=mind.startles + startled,
    )


def _desired_angles(
    mind: PartnerState, manner: BehaviourParameters, view: _ToolPercept, offered: OfferedPart
) -> FloatArray:
    """Where they want their joints (N, 20)."""
    wanted = float_copy(mind.rest_rad)
    xp, most, head = namespace(wanted), constant_like(HEAD_TURN_RAD, wanted), constant_like(_HEAD, wanted)
    faced = xp.clip(manner.facing_share[:, None] * view.facing_rad, -most, most)
    faces = view.aware & (manner.facing_share > 0.0)
    wanted[:, head] = xp.where(faces[:, None], faced, wanted[:, head])
    _glance(wanted, mind, manner)
    _shift(wanted, mind, manner)
    _approach(wanted, mind, manner, offered)
    _withdraw(wanted, mind, manner, view, offered)
    return wanted


def _glance(wanted: FloatArray, mind: PartnerState, manner: BehaviourParameters) -> None:
    """From time to time the head turns away from all else: to the side of a companion, or anywhere."""
    count, share = _cycle(mind, manner.glance_every_s, 2)
    away = (manner.glance_share > 0.0) & (share >= 1.0 - manner.glance_share)
    side = 1.0 - 2.0 * (mind.chance[:, 3] < 0.5)
    anywhere = 2.0 * _uniform(mind.chance[:, 3], count) - 1.0
    yaw = RAD_PER_DEGREE * (side * manner.glance_deg + anywhere * manner.wander_deg)
    wanted[:, _HEAD[2]] = namespace(wanted).where(away, yaw, wanted[:, _HEAD[2]])


def _shift(wanted: FloatArray, mind: PartnerState, manner: BehaviourParameters) -> None:
    """Now and then they sit otherwise; an arm moves outwards, where it has room."""
    count, _ = _cycle(mind, manner.shift_every_s, 3)
    extent = RAD_PER_DEGREE * manner.shift_deg
    for axis, joint in enumerate(_WAIST):
        wanted[:, joint] += extent * (2.0 * _uniform(mind.chance[:, axis], count) - 1.0)
    wanted[:, _SHOULDER] += extent * _uniform(mind.chance[:, 3], count)


def _approach(
    wanted: FloatArray, mind: PartnerState, manner: BehaviourParameters, offered: OfferedPart
) -> None:
    """They lean to a tool that is near, or lift the arm; who hesitates does so in two halves."""
    xp = namespace(wanted)
    hesitates = manner.pause_s > 0.0
    halves = xp.floor(mind.near_s / xp.where(hesitates, manner.pause_s, 1.0))
    come = xp.where(hesitates, xp.minimum(0.5 * halves, 1.0), mind.near_s > 0.0)
    share = manner.approach_share * come
    if offered == "mouth":
        wanted[:, _WAIST[0]] += share * LEAN_RAD
    elif offered == "arm":
        wanted[:, _SHOULDER] += share * LIFT_RAD
        wanted[:, _ELBOW] += share * LIFT_RAD


def _withdraw(
    wanted: FloatArray,
    mind: PartnerState,
    manner: BehaviourParameters,
    view: _ToolPercept,
    offered: OfferedPart,
) -> None:
    """They bend to the other side and turn the face away, or draw the forearm in."""
    starting = (mind.startles > 0.0) & (mind.startled_s <= manner.startle_s)
    extent_deg = manner.away_deg * (mind.near_s > 0.0)
    startle_deg = manner.startle_deg * 0.5 ** (mind.startles - 1.0)
    extent_deg = extent_deg + namespace(startle_deg).where(starting, startle_deg, 0.0)
    extent = RAD_PER_DEGREE * extent_deg
    wanted[:, _WAIST[1]] -= 0.5 * view.side * extent
    if offered == "arm":
        wanted[:, _ELBOW] -= extent
    else:
        wanted[:, _HEAD[0]] -= extent
        wanted[:, _HEAD[2]] -= view.side * extent


def _cycle(mind: PartnerState, every_s: FloatArray, of: int) -> tuple[FloatArray, FloatArray]:
    """How often (N,) something has come round that does every so many seconds, and the share of a round since."""
    rounds = mind.time_s / every_s + mind.chance[:, of]
    count = namespace(rounds).floor(rounds)
    return count, rounds - count


def _uniform(first: FloatArray, count: FloatArray) -> FloatArray:
    """Numbers (N,) in 0..1, another one for each count."""
    value = first + GOLDEN_RATIO_FRACTION * count
    return value - namespace(value).floor(value)


def _track(mind: PartnerState, manner: BehaviourParameters, wanted: FloatArray) -> PartnerState:
    """The targets a control step on their way: as fast as can still be braked before the goal."""
    xp = namespace(wanted)
    startled = (mind.startled_s <= manner.startle_s)[:, None]
    pace = manner.speed_share[:, None]
    most = constant_like(SPEED_RAD_S, wanted) * xp.where(startled, STARTLE_SPEED_FACTOR, pace)
    sudden = xp.where(startled, STARTLE_ACCELERATION_FACTOR, pace)
    change = constant_like(ACCELERATION_RAD_S2, wanted) * sudden * CONTROL_STEP_S
    way = wanted - mind.targets_rad
    braked = xp.sqrt(0.25 * change * change + 2.0 * change / CONTROL_STEP_S * xp.abs(way)) - 0.5 * change
    speed = xp.copysign(xp.minimum(xp.minimum(most, braked), xp.abs(way) / CONTROL_STEP_S), way)
    speed = xp.clip(speed, mind.speed_rad_s - change, mind.speed_rad_s + change)
    return replace(mind, targets_rad=mind.targets_rad + CONTROL_STEP_S * speed, speed_rad_s=speed)
