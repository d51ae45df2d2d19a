"""Detours around a limb and of the hand, compared with laws and with paths of many short segments."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import transforms
from avrgym.simulation.worlds import State
from avrgym.tasks.scratch_itch.detour import (
    TIP_TO_HAND_DISTANCE_M,
    compute_limb_detour_m,
    compute_tool_and_hand_detour_m,
)
from avrgym.tasks.scratch_itch.expert import ROD_DIRECTION
from avrgym.tasks.scratch_itch.feedback_expert import compute_hand_rotation_rad
from avrgym.tasks.scratch_itch.reward import ScratchItchState
from helpers.simulation.worlds import resting_state

RADIUS_M = 0.04
LIMB_POS_W = np.array([-0.3, 0.1, 0.9])
LIMB_Q_W = transforms.normalize(np.array([0.4, -0.2, 0.7, 0.5]))


def detour_m(tool: np.ndarray, itch: np.ndarray) -> np.ndarray:
    """Of tools (N, 3) to itches (N, 3) in the frame of the limb."""
    return compute_limb_detour_m(*seen_with(tool, itch))


def seen_with(tool: np.ndarray, itch: np.ndarray, **changes: np.ndarray) -> tuple[State, ScratchItchState]:
    """What is seen of tools (N, 3) and itches (N, 3) in the frame of the limb, with other changes of the state."""
    count = len(tool)
    seen = resting_state(
        tool_pos_w=LIMB_POS_W + transforms.rotate(LIMB_Q_W, tool),
        right_arm_pos_w=np.tile(LIMB_POS_W, (count, 3, 1)),
        right_arm_quat_w=np.tile(LIMB_Q_W, (count, 3, 1)),
        **changes,
    )
    zeros = np.zeros(count, dtype=np.intp)
    return seen, ScratchItchState(zeros, itch, np.zeros_like(itch), zeros)


def on_cylinder(radius_m: np.ndarray, angle_rad: np.ndarray, along_m: np.ndarray) -> np.ndarray:
    return np.stack([radius_m * np.cos(angle_rad), radius_m * np.sin(angle_rad), along_m], axis=-1)


@pytest.fixture
def places(rng) -> tuple[np.ndarray, np.ndarray]:
    """500 tools outside a limb and itches on it, (500, 3) each, in its frame."""
    tool = on_cylinder(
        rng.uniform(RADIUS_M + 0.001, 0.4, 500), rng.uniform(-np.pi, np.pi, 500), rng.uniform(-0.3, 0.1, 500)
    )
    itch = on_cylinder(np.full(500, RADIUS_M), rng.uniform(-np.pi, np.pi, 500), rng.uniform(-0.3, 0.0, 500))
    return tool, itch


def test_from_skin_to_skin_it_is_a_helix(rng):
    angle, turn, along = (
        rng.uniform(-np.pi, np.pi, 9),
        rng.uniform(-np.pi, np.pi, 9),
        rng.uniform(-0.1, 0.1, 9),
    )
    tool = on_cylinder(np.full(9, RADIUS_M), angle + turn, along)
    itch = on_cylinder(np.full(9, RADIUS_M), angle, np.zeros(9))
    straight_m = np.hypot(2.0 * RADIUS_M * np.sin(0.5 * turn), along)
    assert_allclose(straight_m + detour_m(tool, itch), np.hypot(RADIUS_M * turn, along), rtol=5e-3)


def test_where_the_way_is_free_there_is_none(places):
    tool, itch = places
    in_sight = ((tool - itch)[:, :2] * itch[:, :2]).sum(axis=-1) >= 0.0
    assert 50 < in_sight.sum() < 450
    detour = detour_m(tool, itch)
    assert_allclose(detour[in_sight], 0.0, atol=1e-12)
    assert (detour[~in_sight] > 0.0).all()


def test_it_is_the_same_mirrored_turned_about_the_limb_and_moved_along_it(places):
    tool, itch = places
    turn = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(1.1))
    expected = detour_m(tool, itch)
    for change in (
        lambda place: place * [1.0, -1.0, 1.0],
        lambda place: transforms.rotate(turn, place),
        lambda place: place - [0.0, 0.0, 0.07],
    ):
        assert_allclose(detour_m(change(tool), change(itch)), expected, atol=1e-12)


def test_no_path_outside_the_limb_is_shorter(places):
    """Paths of 2000 pieces around either side, ever nearer to the limb and never in it."""
    tool, itch = places
    shortest_m = np.linalg.norm(tool - itch, axis=-1) + detour_m(tool, itch)
    away, begin, end = np.hypot(tool[:, 0], tool[:, 1]), _angle(tool), _angle(itch)
    turn = (end - begin + np.pi) % (2.0 * np.pi) - np.pi
    share = np.linspace(0.0, 1.0, 2001)
    for way in (turn, turn - np.sign(turn) * 2.0 * np.pi):
        for power in (0.2, 0.5, 1.0, 2.0):
            radius = away[:, None] + (RADIUS_M - away)[:, None] * share**power
            angle = begin[:, None] + way[:, None] * share
            along = tool[:, 2:] + (itch - tool)[:, 2:] * share**power
            path = on_cylinder(radius, angle, along)
            length_m = np.linalg.norm(np.diff(path, axis=1), axis=-1).sum(axis=-1)
            assert (length_m > shortest_m - 1e-4).all()


def test_the_hand_has_a_way_to_go_until_it_is_where_it_has_room(places, rng):
    tool, itch = places
    tool_quat_w = transforms.normalize(rng.normal(size=(500, 4)))
    out_w = transforms.rotate(LIMB_Q_W, itch * [1.0, 1.0, 0.0] / RADIUS_M)
    turn = compute_hand_rotation_rad(transforms.rotate(tool_quat_w, ROD_DIRECTION), out_w)
    hand_m = compute_tool_and_hand_detour_m(*seen_with(tool, itch, tool_quat_w=tool_quat_w)) - detour_m(
        tool, itch
    )
    assert_allclose(hand_m, TIP_TO_HAND_DISTANCE_M * np.linalg.norm(turn, axis=-1))
    there_q_w = transforms.multiply(transforms.from_rotation_vector(turn), tool_quat_w)
    assert_allclose(
        compute_tool_and_hand_detour_m(*seen_with(tool, itch, tool_quat_w=there_q_w)),
        detour_m(tool, itch),
        atol=1e-8,
    )


def _angle(place: np.ndarray) -> np.ndarray:
    return np.arctan2(place[:, 1], place[:, 0])
