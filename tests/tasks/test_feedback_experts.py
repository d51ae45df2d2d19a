from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm, normalize
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.feedback import FeedbackPlanner
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.scratch_itch import expert, feedback_expert
from avrgym.tasks.scratch_itch.expert import compute_skin_directions_w
from avrgym.tasks.scratch_itch.reward import ScratchItchState, compute_itch_limb_frame
from helpers.simulation.itches import around_axis, forearm_itch

OUTSIDE_RAD = np.radians(120.0)


def reset_episodes(environment: str, count: int) -> Episodes:
    """Episodes with revised people."""
    episodes = Episodes(environment, count, people="revised", num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng([6, i]) for i in range(count)])
    return episodes


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_feedback_expert_depends_on_the_present_only(environment):
    """One that saw everything so far and one that comes in now do the same."""
    episodes = reset_episodes(environment, 2)
    make = episodes.task.feedback_expert
    reacts = make(episodes)
    for _ in range(30):
        episodes.step(reacts(episodes.observe()))
    expected = make(episodes)(episodes.observe())
    assert_array_equal(reacts(episodes.observe()), expected)
    assert np.abs(expected).max() <= 1.0 + 1e-9


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_feedback_expert_brings_the_tool_nearer(environment):
    episodes = reset_episodes(environment, 8)
    reacts = episodes.task.feedback_expert(episodes)
    distances = [episodes.step(reacts(episodes.observe())).distance_m.mean() for _ in range(60)]
    assert distances[-1] < 0.5 * distances[0]


def share_of_successes(episodes: Episodes) -> float:
    """In how many worlds the expert has succeeded after an episode."""
    reacts = episodes.task.feedback_expert(episodes)
    success = np.zeros(1, dtype=bool)
    for _ in range(EPISODE_STEPS):
        success = episodes.step(reacts(episodes.observe())).success
    return success.mean()


@pytest.mark.slow
@pytest.mark.parametrize("task", ["Feeding", "ScratchItch", "BedBathing"])
def test_a_feedback_expert_mostly_succeeds(task):
    assert share_of_successes(reset_episodes(f"avrgym/{task}Jaco-v1", 16)) >= 0.5


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_a_feedback_expert_scratches_the_far_side_of_the_forearm(robot):
    """On its upper, inner side, where the robot is on the outer one."""
    episodes = reset_episodes(f"avrgym/ScratchItch{robot}-v1", 8)
    episodes.task_state = forearm_itch(episodes, np.radians(np.linspace(-135.0, -100.0, 8)))
    assert share_of_successes(episodes) >= 0.75


def test_a_tip_goes_around_the_limb_and_not_through_it():
    """From wherever it is outside, a centimetre at a time to where it aims, until it is at the itch."""
    random = np.random.default_rng(0)
    limb, radius = random.integers(2, size=300), random.uniform(0.02, 0.05, 300)
    itch = around_axis(radius, OUTSIDE_RAD * random.uniform(-1.0, 1.0, 300), random.uniform(-0.2, 0.0, 300))
    places = radius + random.uniform(0.005, 0.3, 300)
    tip = around_axis(places, OUTSIDE_RAD * random.uniform(-1.0, 1.0, 300), random.uniform(-0.4, 0.2, 300))
    task_state = ScratchItchState(limb, itch, np.zeros_like(itch), np.zeros_like(limb))
    arrived = np.zeros(300, dtype=bool)
    for _ in range(100):
        arrived |= norm(tip - itch) < 0.03
        step = feedback_expert.compute_tip_target_around_limb(tip, task_state) - tip
        tip = tip + np.where(arrived[:, None], 0.0, 0.01 * step / norm(step)[:, None])
        assert np.all(arrived | (norm(tip[:, :2]) >= radius))
    assert arrived.all()


@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_an_arm_that_leans_on_the_person_draws_back(robot):
    episodes = reset_episodes(f"avrgym/ScratchItch{robot}-v1", 4)
    planner, state, itch = FeedbackPlanner(episodes), episodes.get_state(), episodes.task_state
    leaning = replace(state, links_force_n=np.array([0.0, 4.0, 6.0, 100.0]))
    pos_w, q_w, speed = feedback_expert.compute_scratching_target(leaning, itch, planner)
    free = feedback_expert.compute_scratching_target(replace(state, links_force_n=np.zeros(4)), itch, planner)
    for now, then in zip((pos_w, q_w, speed), free, strict=True):
        assert_array_equal(now[:2], then[:2])
    out_w, _ = compute_skin_directions_w(itch, compute_itch_limb_frame(state, itch)[1])
    away = pos_w - planner.tool_pos_w
    in_front = feedback_expert.compute_front_approach_weight(out_w) * (robot == "Jaco")
    assert_allclose(
        normalize(away[2:]), feedback_expert.compute_hand_direction_w(out_w, in_front)[2:], atol=1e-12
    )
    assert np.all(speed[2:] > 0.0)
    assert_array_equal(q_w[2:], planner.tool_quat_w[2:])


def directions(seed: int) -> np.ndarray:
    """Unit vectors (500, 3)."""
    return normalize(np.random.default_rng(seed).normal(size=(500, 3)))


@pytest.mark.parametrize(
    ("in_front", "slant_rad"),
    [(0.0, feedback_expert.MAX_HAND_ANGLE_RAD), (1.0, feedback_expert.FRONT_MAX_HAND_ANGLE_RAD)],
)
def test_a_scratching_hand_stays_out_of_the_skin(in_front, slant_rad):
    out_w = directions(0)
    hand_w = feedback_expert.compute_hand_direction_w(out_w, np.full(500, in_front))
    assert_allclose(norm(hand_w), 1.0)
    assert np.all((hand_w * out_w).sum(axis=-1) >= np.cos(slant_rad) - 1e-9)


@pytest.mark.parametrize(
    ("in_front", "askew_rad"),
    [(0.0, feedback_expert.MAX_ROD_ANGLE_RAD), (1.0, feedback_expert.FRONT_MAX_ROD_ANGLE_RAD)],
)
def test_a_rod_that_has_turned_need_not_turn_again(in_front, askew_rad):
    rod_w, out_w, front = directions(0), directions(1), np.full(500, in_front)
    turn = feedback_expert.compute_hand_rotation_rad(rod_w, out_w, front)
    turned_w = transforms.rotate(transforms.from_rotation_vector(turn), rod_w)
    assert (norm(turn) > 0.1).sum() > 400
    assert_allclose(feedback_expert.compute_hand_rotation_rad(turned_w, out_w, front), 0.0, atol=1e-7)
    beside_rad = np.arccos((-turned_w * feedback_expert.compute_hand_direction_w(out_w, front)).sum(axis=-1))
    assert np.all(beside_rad <= askew_rad + 1e-7)


def test_only_skin_that_faces_in_is_reached_from_in_front():
    out_w = directions(0)
    share = feedback_expert.compute_front_approach_weight(out_w)
    inner = (out_w[:, 0] > feedback_expert.INWARD_NORMAL_RANGE[1]) & (
        out_w[:, 2] > feedback_expert.NOT_DOWNWARD_NORMAL_RANGE[1]
    )
    assert inner.any()
    assert np.all(share[inner] == 1.0)
    assert np.all(
        share[
            (out_w[:, 0] < feedback_expert.INWARD_NORMAL_RANGE[0])
            | (out_w[:, 2] < feedback_expert.NOT_DOWNWARD_NORMAL_RANGE[0])
        ]
        == 0.0
    )
    assert ((share > 0.0) & (share < 1.0)).any()


@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_a_hand_that_comes_from_in_front_turns_before_it_comes(robot):
    """With the itch on the inner side of the forearm a mounted arm aims before the wrist, and then at the itch."""
    episodes = reset_episodes(f"avrgym/ScratchItch{robot}-v1", 8)
    itch = forearm_itch(episodes, np.full(8, np.radians(-150.0)))
    planner, state = FeedbackPlanner(episodes), episodes.get_state()
    out_w, _ = compute_skin_directions_w(itch, compute_itch_limb_frame(state, itch)[1])
    in_front = feedback_expert.compute_front_approach_weight(out_w) == 1.0
    before_wrist_w = state.right_arm_pos_w[:, 2] + expert.DETOUR_OFFSET_M
    goal_w, _, _ = feedback_expert.compute_scratching_target(state, itch, planner)
    waits = np.all(np.abs(goal_w - before_wrist_w) < 1e-9, axis=-1)
    assert in_front.any()
    assert_array_equal(waits, in_front & (robot == "Jaco"))
