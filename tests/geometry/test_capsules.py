from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.geometry.capsules import segment_box_distance, segment_distance

SHARES = np.linspace(0.0, 1.0, 201)


def random_rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    return transforms.normalize(rng.normal(size=(count, 4)))


@pytest.fixture
def segments(rng) -> list[np.ndarray]:
    """Ends a0, a1, b0, b1, each (600, 3): any pairs, parallel ones, ones with a point, ones that touch."""
    a0, a1, b0, b1 = rng.uniform(-1.0, 1.0, (4, 600, 3))
    b1[100:200] = b0[100:200] + rng.uniform(-2.0, 2.0, (100, 1)) * (a1 - a0)[100:200]
    a1[200:250] = a0[200:250]
    b1[225:275] = b0[225:275]
    b0[300:350] = a0[300:350] + 0.3 * (a1 - a0)[300:350]
    b1[350:400] = b0[350:400] + (a1 - a0)[350:400] + 1e-9 * b1[350:400]
    return [a0, a1, b0, b1]


@dataclass(frozen=True)
class Boxes:
    """Boxes and segments, all (n, …)."""

    pos: np.ndarray
    q: np.ndarray
    half: np.ndarray
    s0: np.ndarray
    s1: np.ndarray

    def distance(self, rows: slice = slice(None)) -> np.ndarray:
        return segment_box_distance(
            self.pos[rows], self.q[rows], self.half[rows], self.s0[rows], self.s1[rows]
        )


@pytest.fixture
def boxes(rng) -> Boxes:
    """Any pairs (600), among them segments through a box, along its axes, and points."""
    pos, s0, s1 = rng.uniform(-0.6, 0.6, (3, 600, 3))
    q = random_rotations(rng, 600)
    half = rng.uniform(0.02, 0.4, (600, 3))
    s1[100:200] = s0[100:200] + transforms.rotate(q[100:200], np.eye(3)[rng.integers(3, size=100)])
    q[200:300] = transforms.IDENTITY_QUATERNION
    s1[250:300] = s0[250:300] + 0.5 * np.eye(3)[0]
    s1[300:350] = s0[300:350]
    s0[350:450] = pos[350:450] - (s1 - pos)[350:450]
    return Boxes(pos, q, half, s0, s1)


# Segments


def test_no_sampled_pair_of_points_is_closer_than_the_segments(segments):
    a0, a1, b0, b1 = segments
    a = a0[:, None] + SHARES[:, None] * (a1 - a0)[:, None]
    b = b0[:, None] + SHARES[:, None] * (b1 - b0)[:, None]
    sampled = np.array(
        [np.linalg.norm(p[:, None] - q[None], axis=-1).min() for p, q in zip(a, b, strict=True)]
    )
    spacing = 0.5 * (np.linalg.norm(a1 - a0, axis=-1) + np.linalg.norm(b1 - b0, axis=-1)) / (len(SHARES) - 1)
    distance = segment_distance(a0, a1, b0, b1)
    assert (distance <= sampled + 1e-8).all()
    assert (distance >= sampled - spacing - 1e-8).all()


def test_segments_have_the_same_distance_from_either_side(segments):
    a0, a1, b0, b1 = segments
    distance = segment_distance(a0, a1, b0, b1)
    assert_allclose(segment_distance(b0, b1, a0, a1), distance, atol=1e-8)
    assert_allclose(segment_distance(a1, a0, b0, b1), distance, atol=1e-8)


def test_moving_everything_keeps_the_distance_of_segments(rng, segments):
    q, offset = random_rotations(rng, 600), rng.uniform(-1.0, 1.0, (600, 3))
    moved = [offset + transforms.rotate(q, end) for end in segments]
    assert_allclose(segment_distance(*moved), segment_distance(*segments), atol=1e-8)


@pytest.mark.parametrize(
    ("b0", "b1", "expected"),
    [
        ([0.5, 1.0, -1.0], [0.5, 1.0, 1.0], 1.0),
        ([2.0, 0.0, 0.0], [5.0, 0.0, 0.0], 1.0),
        ([0.2, 3.0, 0.0], [0.7, 3.0, 0.0], 3.0),
        ([-3.0, 4.0, 0.0], [-3.0, 4.0, 0.0], 5.0),
        ([0.5, 0.0, -1.0], [0.5, 0.0, 1.0], 0.0),
    ],
)
def test_the_distance_of_a_unit_segment_from_others(b0, b1, expected):
    ends = [np.array(end, float) for end in ([0, 0, 0], [1, 0, 0], b0, b1)]
    assert segment_distance(*ends) == pytest.approx(expected, abs=1e-15)


# Boxes


def test_no_sampled_point_of_a_segment_is_closer_to_its_box(boxes):
    points = boxes.s0[:, None] + SHARES[:, None] * (boxes.s1 - boxes.s0)[:, None]
    inside = transforms.rotate(transforms.conjugate(boxes.q)[:, None], points - boxes.pos[:, None])
    beyond = np.maximum(np.abs(inside) - boxes.half[:, None], 0.0)
    sampled = np.linalg.norm(beyond, axis=-1).min(axis=1)
    spacing = 0.5 * np.linalg.norm(boxes.s1 - boxes.s0, axis=-1) / (len(SHARES) - 1)
    distance = boxes.distance()
    assert (distance <= sampled + 1e-12).all()
    assert (distance >= sampled - spacing - 1e-12).all()
    assert 0.2 < (distance == 0.0).mean() < 0.8


def test_a_segment_is_as_far_from_a_box_from_either_end(boxes):
    turned = segment_box_distance(boxes.pos, boxes.q, boxes.half, boxes.s1, boxes.s0)
    assert_allclose(turned, boxes.distance(), atol=1e-12)


def test_moving_everything_keeps_the_distance_of_segments_and_boxes(rng, boxes):
    q, offset = random_rotations(rng, 600), rng.uniform(-1.0, 1.0, (600, 3))
    pos, s0, s1 = (offset + transforms.rotate(q, v) for v in (boxes.pos, boxes.s0, boxes.s1))
    moved = segment_box_distance(pos, transforms.multiply(q, boxes.q), boxes.half, s0, s1)
    assert_allclose(moved, boxes.distance(), atol=1e-12)


@pytest.mark.parametrize(
    ("s0", "s1", "expected"),
    [
        ([-3.0, 0.0, 0.4], [4.0, 0.0, 0.4], 0.3),
        ([4.5, 0.0, 0.0], [4.5, 9.0, 0.0], 3.0),
        ([1.5, 0.5, 0.5], [1.5, 2.0, 3.0], 0.5),
        ([0.8, 0.1, 0.0], [5.0, 5.0, 5.0], 0.0),
    ],
)
def test_the_distance_of_a_box_from_segments(s0, s1, expected):
    box = np.array([1.0, 0.0, 0.0]), transforms.IDENTITY_QUATERNION, np.array([0.5, 0.2, 0.1])
    assert segment_box_distance(*box, np.array(s0), np.array(s1)) == pytest.approx(expected, abs=1e-15)


def test_a_pair_does_not_depend_on_others(segments, boxes):
    assert_array_equal(segment_distance(*(end[77] for end in segments)), segment_distance(*segments)[77])
    assert_array_equal(boxes.distance(slice(77, 78))[0], boxes.distance()[77])


def test_each_box_meets_each_segment(boxes):
    many = segment_box_distance(
        boxes.pos[:5, None], boxes.q[:5, None], boxes.half[0], boxes.s0[None, :7], boxes.s1[None, :7]
    )
    assert many.shape == (5, 7)
    one = segment_box_distance(boxes.pos[3], boxes.q[3], boxes.half[0], boxes.s0[6], boxes.s1[6])
    assert_array_equal(many[3, 6], one)


# MuJoCo says the same


RADIUS = 0.03


def mujoco_distances(geoms: list[str]) -> np.ndarray:
    """The distances between each geom and the one that follows it in pairs, by ``mj_geomDistance``."""
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{''.join(geoms)}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.array(
        [mujoco.mj_geomDistance(model, data, i, i + 1, 10.0, None) for i in range(0, model.ngeom, 2)]
    )


def capsule(s0: np.ndarray, s1: np.ndarray) -> str:
    return f'<geom type="capsule" size="{RADIUS}" fromto="{text(s0)} {text(s1)}"/>'


def text(values: np.ndarray) -> str:
    return " ".join(map(repr, map(float, values)))


def test_capsules_are_as_far_apart_as_in_mujoco(segments):
    a0, a1, b0, b1 = (end[:100] for end in segments)
    geoms = [capsule(*ends) for i in range(100) for ends in ((a0[i], a1[i]), (b0[i], b1[i]))]
    distance = segment_distance(a0, a1, b0, b1) - 2 * RADIUS
    assert_allclose(mujoco_distances(geoms), distance, atol=1e-6)


def test_capsules_are_as_far_from_boxes_as_in_mujoco(boxes):
    distance = boxes.distance()[:250] - RADIUS
    geoms = [
        geom
        for i in range(250)
        for geom in (
            f'<geom type="box" size="{text(boxes.half[i])}" pos="{text(boxes.pos[i])}" quat="{text(boxes.q[i])}"/>',
            capsule(boxes.s0[i], boxes.s1[i]),
        )
    ]
    apart = distance > 0.0
    assert apart.sum() > 50
    assert_allclose(mujoco_distances(geoms)[apart], distance[apart], atol=1e-5)
