"""Itch scratching: rub the spot of the right arm that itches, gently and to and fro (paper, section IV)."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import elementary, transforms
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.furniture import add_wheelchair_without_right_armrest
from avrgym.models.human import People
from avrgym.models.robot import Robot
from avrgym.models.scene import SceneConfig
from avrgym.models.scratcher import SCRATCHER
from avrgym.people.distributions import Pose
from avrgym.simulation.worlds import RightArm, Start, State
from avrgym.tasks import places
from avrgym.tasks.base import (
    ARM_SPREAD_RAD,
    LIMBS,
    STRONG_FORCE_N,
    Marks,
    StepResult,
    Task,
    above_clothes,
    arm_angles,
    force,
    position,
    quaternion,
    when_strong,
)

Array = NDArray[np.float64]

ITCH_RADIUS_M = 0.025
STROKE_M = 0.01
SUCCESS_SCRATCHES = 25
CHAIR = add_wheelchair_without_right_armrest
ALONG = (0.2, 0.85)
"""Where along a limb it may itch, as shares of its length: its ends lie inside shoulder and elbow."""
AROUND_RAD = (np.radians(120.0), np.pi)
"""How far around each limb it may itch, either way from its outer side. The third of the upper arm that faces the
torso is left out: no hand of our robots fits between the two."""
HAND_M, MOBILE_HAND_M = (-0.5, 0.0, 0.8), (-0.55, 0.0, 0.8)
HAND_SPREAD_M = 0.05
SCRATCHER_Q_W = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(-0.25 * np.pi))
"""Pointing 45° upwards at the person's shoulder, past their elbow."""

POSE = Pose(
    rest_rad=human.joint_angles(right_shoulder_y=30.0),
    spread_rad=ARM_SPREAD_RAD,
)
"""Seated, the right arm spread by 30°, each of its joints within ±10° (paper, section V; reference)."""

WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "force_at_itch_n": 0.01,
    "scratch_force_n": 2.0,
    "tool_speed_m_s": -0.25,
    "force_elsewhere_n": -0.01,
    "strong_force_at_itch_n": -0.05,
}
"""Task weights, then the preferences of the person (paper, section IV; reference)."""


@dataclass(frozen=True)
class ScratchItchState:
    """Where it itches and how often it was scratched.

    ``limb`` (N,) counts in ``LIMBS``. ``itch`` and ``last_scratch`` (N, 3), metres, are places in the frame of
    that limb: they move with the person. ``scratches`` (N,).
    """

    limb: NDArray[np.intp]
    itch: Array
    last_scratch: Array
    scratches: NDArray[np.intp]


def scene(robot: Robot) -> SceneConfig:
    """A wheelchair whose right armrest is taken off, where the person's arm hangs; the left arm scratches."""
    return places.wheelchair_scene(robot, "left", SCRATCHER, (0.1, 0.0), chair=CHAIR)


def start(scene: SceneConfig, people: People, uniforms: Array) -> Start:
    """Hand within ±5 cm of a point beside the person's elbow; the goals are shoulder, elbow and wrist."""
    place = MOBILE_HAND_M if scene.mount.on_floor else HAND_M
    hand = np.array(place) + HAND_SPREAD_M * (2.0 * uniforms[:, 0:3] - 1.0)
    tool, tool_q = places.held(scene, hand, SCRATCHER_Q_W)
    goals = places.right_arm(people, scene.posture)
    goals_q = np.tile(SCRATCHER_Q_W, (*goals.shape[:2], 1))
    return places.start(scene, people, {}, tool, tool_q, goals, goals_q, uniforms[:, 6:])


def init_state(people: People, uniforms: Array) -> ScratchItchState:
    """An itch on the upper arm or the forearm with equal chance, uniform along it and around it."""
    limb = (uniforms[:, 3] < 0.5).astype(np.intp)
    layout = human.layout(people.is_woman, people.torso_height_m)
    sizes = np.stack([layout.geom_size[name] for name in LIMBS], axis=1)[np.arange(len(limb)), limb]
    radius, length = sizes[:, 0], 2.0 * sizes[:, 1]
    along = length * (ALONG[0] + (ALONG[1] - ALONG[0]) * uniforms[:, 4])
    around = np.array(AROUND_RAD)[limb] * (2.0 * uniforms[:, 5] - 1.0)
    sine, cosine = elementary.sine_and_cosine(around)
    itch = np.stack([-radius * cosine, radius * sine, -along], axis=-1)
    return ScratchItchState(limb, itch, np.zeros_like(itch), np.zeros_like(limb))


OBSERVED = (
    position("tool_from_torso_m"),
    quaternion("tool_rotation"),
    position("tool_from_itch_m"),
    position("itch_from_torso_m"),
    arm_angles("arm_angles_rad"),
    position("shoulder_from_torso_m"),
    position("elbow_from_torso_m"),
    position("wrist_from_torso_m"),
    force("tool_force_n"),
)


def observe(state: State, task_state: ScratchItchState) -> Array:
    """The observation (N, 30), in the order of ``OBSERVED``; in the world's axes."""
    itch_w = itch_pos_w(state, task_state)
    person_arm = state.right_arm_pos_w - state.robot_pos_w[:, None]
    return np.concatenate(
        [
            state.tool_pos_w - state.robot_pos_w,
            state.tool_q_w,
            state.tool_pos_w - itch_w,
            itch_w - state.robot_pos_w,
            state.arm_angles_rad,
            person_arm.reshape(len(person_arm), 9),
            state.tool_force_n[:, None],
        ],
        axis=-1,
    )


def evaluate_step(state: State, action: Array, task_state: ScratchItchState) -> StepResult:
    """At most one scratch in a control step.

    It is a contact of the tool within 2.5 cm of the itch, softer than 10 N, whose place (the mean of such
    contacts, weighted by their forces) has moved more than 1 cm in the limb's frame since the last scratch.
    """
    itch_w = itch_pos_w(state, task_state)
    force_n, place = _touch(state, task_state, itch_w)
    moved = norm(place - task_state.last_scratch) > STROKE_M
    scratch = (force_n > 0.0) & (force_n < STRONG_FORCE_N) & (moved | (task_state.scratches == 0))
    after = ScratchItchState(
        task_state.limb,
        task_state.itch,
        np.where(scratch[:, None], place, task_state.last_scratch),
        task_state.scratches + scratch,
    )
    distance = norm(state.tool_pos_w - itch_w)
    terms = {
        "distance_m": distance,
        "action_squared": (action * action).sum(axis=-1),
        "force_at_itch_n": force_n,
        "scratch_force_n": np.where(scratch, force_n, 0.0),
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "force_elsewhere_n": np.maximum(state.total_force_n - force_n, 0.0),
        "strong_force_at_itch_n": when_strong(force_n),
    }
    success = after.scratches >= SUCCESS_SCRATCHES
    nothing = np.zeros((len(distance), 0), dtype=bool)
    return StepResult(after, terms, distance, state.total_force_n, success, nothing)


def itch_pos_w(state: State, task_state: ScratchItchState) -> Array:
    """Where it itches, (N, 3), world frame."""
    limb_pos_w, limb_q_w = limb_frame(state, task_state)
    return limb_pos_w + transforms.rotate(limb_q_w, task_state.itch)


def limb_frame(arm: RightArm, task_state: ScratchItchState) -> tuple[Array, Array]:
    """The frame of the limb that itches: (N, 3) and (N, 4), world frame."""
    worlds = np.arange(len(task_state.limb))
    return arm.right_arm_pos_w[worlds, task_state.limb], arm.right_arm_q_w[worlds, task_state.limb]


def _touch(state: State, task_state: ScratchItchState, itch_w: Array) -> tuple[Array, Array]:
    """How strongly the tool touches the itch, (N,) newtons, and where, (N, 3) in the limb's frame."""
    near = norm(state.tool_contact_pos_w - itch_w[:, None]) < ITCH_RADIUS_M
    forces = np.where(near, state.tool_contact_force_n, 0.0)
    force_n = forces.sum(axis=-1)
    place_w = (forces[..., None] * state.tool_contact_pos_w).sum(axis=1) / np.maximum(force_n, 1e-9)[:, None]
    limb_pos_w, limb_q_w = limb_frame(state, task_state)
    return force_n, transforms.rotate(transforms.conjugate(limb_q_w), place_w - limb_pos_w)


def marks_w(arm: RightArm, task_state: ScratchItchState) -> Array:
    """Where the itch is drawn, (N, 1, 3), world frame."""
    limb_pos_w, limb_q_w = limb_frame(arm, task_state)
    return (limb_pos_w + transforms.rotate(limb_q_w, above_clothes(task_state.itch)))[:, None]


MARKS = Marks(
    count=1,
    radius_m=0.008,
    rgb=(0.85, 0.10, 0.12),
    places=marks_w,
)

SCRATCH_ITCH = Task(
    name="ScratchItch",
    goal="Get the itch on your right arm scratched.",
    offered="arm",
    pose=POSE,
    uniforms=6 + places.UNIFORMS,
    observed=OBSERVED,
    weights=WEIGHTS,
    scene=scene,
    start=start,
    init_state=init_state,
    observe=observe,
    evaluate_step=evaluate_step,
    marks=MARKS,
)
