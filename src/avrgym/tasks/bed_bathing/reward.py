"""Reward of bed bathing: markers wiped off the right arm, and the preferences of the person.

Markers cover upper arm and forearm, 3 cm apart. A marker is wiped if the cloth's wiping face touches the person within
2.5 cm of it. For a flat pad on a round limb, MuJoCo reports only the ends of the contact line. The touched points are
therefore the segment between the first and the last contact along the limb. Only contacts within 2.5 cm of the limb's
surface are used.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import capsules, elementary, transforms
from avrgym.geometry.arrays import constant_like, find_indices_to_compute, get_namespace, make_row_indices
from avrgym.geometry.transforms import norm
from avrgym.models import human
from avrgym.models.human import BODY_DIMENSIONS, RECLINED_POSTURE, TORSO_HEIGHT_RANGE_M, People
from avrgym.models.washcloth import PAD_CENTRE_M, PAD_CONTACT_MARGIN_M, PAD_HALF_SIZE_M
from avrgym.simulation.worlds import State
from avrgym.tasks.person import RIGHT_ARM_LIMBS, zero_comfortable_forces
from avrgym.tasks.task import StepResult

MARKER_SPACING_M = 0.03
WIPE_RADIUS_M = 0.025
MIN_CONTACT_NORMAL_COSINE = 0.26
"""Cosine of 75°. This is the maximum angle between the normals of the wiping face and of a contact at its rim."""
SUCCESS_MARKER_FRACTION = 0.30
ROUNDING_MARGIN_M = 1e-5
"""Upper bound of the rounding errors of distances, also in single precision."""

REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "markers_wiped": 5.0,
    "tool_speed_m_s": -0.25,
    "force_elsewhere_n": -0.01,
    "strong_force_at_arm_n": -0.05,
}
"""Weights of the reward terms: first of the task, then of the person's preferences (paper, section IV, and its
code).
"""

LIMB_GEOM_INDICES = np.array([list(human.GEOMS).index(name) for name in RIGHT_ARM_LIMBS])


@dataclass(frozen=True)
class BedBathingState:
    """Markers on upper arm and forearm. Both limbs have ``MARKERS_PER_LIMB`` marker slots, the number for the largest
    limb.

    ``marker_pos`` (N, 2, ``MARKERS_PER_LIMB``, 3) are positions in the frames of the two limbs, metres. ``exists`` and
    ``wiped`` are masks (N, 2, ``MARKERS_PER_LIMB``): used slots, and wiped markers.
    """

    marker_pos: FloatArray
    exists: BoolArray
    wiped: BoolArray


def _largest(measure: str) -> float:
    return max(getattr(p, measure) for p in BODY_DIMENSIONS.values())


def _max_rings() -> int:
    tallest = TORSO_HEIGHT_RANGE_M[1]
    lengths = [p.upper_arm_length_m * tallest / p.torso_height_m for p in BODY_DIMENSIONS.values()]
    return int(max(lengths) / MARKER_SPACING_M)


MAX_RINGS = _max_rings()
MARKERS_PER_RING = int(2.0 * np.pi * _largest("upper_arm_radius_m") / MARKER_SPACING_M)
MARKERS_PER_LIMB = MAX_RINGS * MARKERS_PER_RING
"""Number of marker slots of a limb. Upper arms need more than forearms, because they are longer and thicker."""


def make_initial_task_state(people: People, uniforms: FloatArray) -> BedBathingState:
    """Returns the initial task state: rings 3 cm apart with markers 3 cm apart, none wiped.

    On thick arms, the distance between markers is larger.
    """
    xp = get_namespace(uniforms)
    size = human.compute_people_layout(people, RECLINED_POSTURE).geom_size
    radius = xp.stack([size[limb][:, 0] for limb in RIGHT_ARM_LIMBS], axis=1)[..., None]
    length = 2.0 * xp.stack([size[limb][:, 1] for limb in RIGHT_ARM_LIMBS], axis=1)[..., None]
    rings, around = (
        xp.minimum(length // MARKER_SPACING_M, MAX_RINGS),
        xp.minimum(2.0 * np.pi * radius // MARKER_SPACING_M, MARKERS_PER_RING),
    )
    ring, spot = (
        constant_like(each, uniforms) for each in np.divmod(np.arange(MARKERS_PER_LIMB), MARKERS_PER_RING)
    )
    along = 0.5 * length + (ring - 0.5 * (rings - 1.0)) * MARKER_SPACING_M
    angle = 2.0 * np.pi * spot / around
    sine, cosine = elementary.sine_and_cosine(angle)
    pos = xp.stack([radius * cosine, radius * sine, -along], axis=-1)
    exists = (ring < rings) & (spot < around)
    return BedBathingState(pos, exists, xp.zeros_like(exists))


def evaluate_step(state: State, action: FloatArray, task_state: BedBathingState) -> StepResult:
    """Returns the result of a step: markers under the cloth's wiping face are wiped.

    The force at the target is the sum over the cloth's contacts within 2.5 cm of upper arm or forearm. All other
    contact forces are force elsewhere.
    """
    xp = get_namespace(state.tool_pos_w)
    contact_pos, near, on_face = _contacts_of_limbs(state)
    wiping = near & on_face[:, None]
    newly_wiped = task_state.exists & ~task_state.wiped & _touched(contact_pos, wiping, task_state.marker_pos)
    after = replace(task_state, wiped=task_state.wiped | newly_wiped)
    force_at_arm = xp.where(near.any(axis=1), state.tool_contact_force_n, 0.0).sum(axis=-1)
    distance = compute_cloth_distance_m(state)
    wiped = newly_wiped.sum(axis=(-2, -1))
    terms = {
        "distance_m": distance,
        "action_squared": (action * action).sum(axis=-1),
        "markers_wiped": 1.0 * wiped,
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "force_elsewhere_n": xp.maximum(state.total_force_n - force_at_arm, 0.0),
        "strong_force_at_arm_n": zero_comfortable_forces(force_at_arm),
    }
    nothing = xp.zeros((len(distance), 0), dtype=xp.bool, device=distance.device)
    return StepResult(
        after, terms, distance, state.total_force_n, are_enough_markers_wiped(after), wiped, nothing
    )


def are_enough_markers_wiped(task_state: BedBathingState) -> BoolArray:
    """Returns a boolean mask (N,) of worlds in which enough markers are wiped for success."""
    return _count(task_state.wiped) >= SUCCESS_MARKER_FRACTION * _count(task_state.exists)


def compute_cloth_distance_m(state: State) -> FloatArray:
    """Returns the distance (N,) of the cloth from the person's body in metres; 0 in contact.

    The distance from the centre of the pad is an upper bound of a capsule's distance. Minus the radius of the pad, it
    is a lower bound. A capsule with a lower bound above the smallest upper bound is not the nearest; its distance is
    not computed.
    """
    xp, half_size_m = get_namespace(state.tool_pos_w), PAD_HALF_SIZE_M - PAD_CONTACT_MARGIN_M
    centre_w = state.tool_pos_w + transforms.rotate(state.tool_quat_w, PAD_CENTRE_M)
    begin_w, end_w = state.person_capsule_ends_w[:, :, 0], state.person_capsule_ends_w[:, :, 1]
    upper = capsules.point_segment_distance(centre_w[:, None], begin_w, end_w) - state.person_radius_m
    pad_radius_m = float(norm(half_size_m)) + ROUNDING_MARGIN_M
    world, geom = find_indices_to_compute(upper - pad_radius_m <= xp.min(upper, axis=-1, keepdims=True))
    gap = xp.full_like(upper, np.inf)
    gap[world, geom] = (
        capsules.segment_box_distance(
            centre_w[world], state.tool_quat_w[world], half_size_m, begin_w[world, geom], end_w[world, geom]
        )
        - state.person_radius_m[world, geom]
    )
    return xp.maximum(xp.min(gap, axis=-1) - PAD_CONTACT_MARGIN_M, 0.0)


def _contacts_of_limbs(state: State) -> tuple[FloatArray, BoolArray, BoolArray]:
    """Returns the cloth's contacts (N, 2, C, 3) in the frames of both limbs.

    Also returns two masks: (N, 2, C) for contacts within 2.5 cm of the limb, and (N, C) for contacts on the cloth's
    wiping face. ``_on_face`` defines the second mask.
    """
    xp, limbs = get_namespace(state.tool_pos_w), constant_like(LIMB_GEOM_INDICES, state.tool_pos_w)
    touching = state.tool_contact_force_n > 0.0
    shape = len(touching), len(RIGHT_ARM_LIMBS), touching.shape[1]
    contact_pos = xp.zeros((*shape, 3), dtype=state.tool_pos_w.dtype, device=touching.device)
    near = xp.zeros(shape, dtype=xp.bool, device=touching.device)
    on_face = xp.zeros_like(touching)
    (rows,) = find_indices_to_compute(touching.any(axis=-1))
    if not len(rows):
        return contact_pos, near, on_face
    limb_w, to_limb = (
        state.right_arm_pos_w[rows, :2, None],
        transforms.conjugate(state.right_arm_quat_w[rows, :2, None]),
    )
    pos = transforms.rotate(to_limb, state.tool_contact_pos_w[rows, None] - limb_w)
    segment_w = state.person_capsule_ends_w[rows][:, limbs]
    beside_axis = xp.asarray(pos, copy=True)
    beside_axis[..., 2] += xp.clip(
        -pos[..., 2], 0.0, norm(segment_w[:, :, 1] - segment_w[:, :, 0])[..., None]
    )
    gap = norm(beside_axis) - state.person_radius_m[rows][:, limbs, None]
    contact_pos[rows], near[rows] = pos, (gap < WIPE_RADIUS_M) & touching[rows, None]
    on_face[rows] = _on_face(state, rows)
    return contact_pos, near, on_face


def _on_face(state: State, rows: IntArray) -> BoolArray:
    """Returns a mask (n, C) of contacts on the cloth's wiping face or its rim, not on the sides or the rear.

    ``rows`` (n,) are the worlds.

    These contacts are in the front half of the pad. Their normals differ by less than 75° from the normal of the wiping
    face (at a side: 90°).
    """
    to_pad = transforms.conjugate(state.tool_pad_quat_w[rows, None])
    place = transforms.rotate(to_pad, state.tool_contact_pos_w[rows] - state.tool_pad_pos_w[rows, None])
    normal = transforms.rotate(to_pad, state.tool_contact_normal_w[rows])
    return (place[..., 0] > PAD_CENTRE_M[0]) & (normal[..., 0] > MIN_CONTACT_NORMAL_COSINE)


def _touched(contact_pos: FloatArray, near: BoolArray, marker_pos: FloatArray) -> BoolArray:
    """Returns a boolean mask (N, 2, M) of markers within 2.5 cm of the touched segment of their limb."""
    xp = get_namespace(marker_pos)
    touching = xp.any(near, axis=-1)
    touched = xp.zeros(marker_pos.shape[:-1], dtype=xp.bool, device=near.device)
    world, limb = find_indices_to_compute(touching)
    if len(world):
        first, last = _ends(contact_pos[world, limb], near[world, limb])
        markers = marker_pos[world, limb]
        distance = capsules.segment_distance(markers, markers, first[:, None], last[:, None])
        touched[world, limb] = distance < WIPE_RADIUS_M
    return touched & touching[..., None]


def _ends(pos: FloatArray, near: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Returns the first and the last contact along the limb, (n, 3) each.

    ``near`` is the mask of contacts (n, C, 3) near the limb.
    """
    xp, row, along = get_namespace(pos), make_row_indices(pos), -pos[..., 2]
    first = xp.where(near, along, np.inf).argmin(axis=-1)
    last = xp.where(near, along, -np.inf).argmax(axis=-1)
    return pos[row, first], pos[row, last]


def _count(markers: BoolArray) -> FloatArray:
    return 1.0 * markers.sum(axis=(-2, -1))
