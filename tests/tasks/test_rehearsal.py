"""Motions that are rehearsed before an episode: their cost, and the initial states that follow from it."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.geometry import transforms
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.path_cost import CLEARANCE_MARGIN_M, GoalPathCost

CROWDED_WORLDS = [7, 15, 29]
"""People in contact with the Panda's links at the base with the highest isotropy."""


def reset_episodes(robot: str, worlds: list[int]) -> Episodes:
    episodes = Episodes(f"avrgym/Dressing{robot}-v1", len(worlds), people="revised", num_threads=1)
    episodes.reset(np.arange(len(worlds)), [np.random.default_rng([9, world]) for world in worlds])
    return episodes


def cost_m(episodes: Episodes, goal_w: np.ndarray) -> np.ndarray:
    """Cost (N,) of moving the tools from their present poses to points (N, 3) without a turn."""
    state, chain = episodes.get_state(), placement.make_planning_chain(episodes.scene)
    q_w = state.tool_quat_w
    rehearsal = GoalPathCost(
        episodes.scene, chain, episodes.people, state.tool_pos_w, q_w, goal_w[:, None], q_w[:, None]
    )
    base_w, base_q_w = episodes.simulation.get_initial_base_pose()
    yaw_rad = transforms.to_rotation_vector(base_q_w)[:, 2:]
    return rehearsal(base_w[:, None], yaw_rad, episodes.simulation.get_joint_positions()[:, None])[:, 0]


def test_a_path_through_the_person_or_out_of_reach_costs_more() -> None:
    episodes = reset_episodes("Panda", [0, 1])
    state = episodes.get_state()
    chest_w = state.person_capsule_ends_w[:, 2].mean(axis=1)
    assert (cost_m(episodes, state.tool_pos_w) < CLEARANCE_MARGIN_M).all()
    assert (cost_m(episodes, chest_w) > 2.0 * CLEARANCE_MARGIN_M).all()
    assert (cost_m(episodes, state.tool_pos_w + np.array([0.0, 0.0, 2.0])) > 0.5).all()


def test_the_arm_keeps_clear_of_the_person_on_the_whole_path() -> None:
    """Without the rehearsal, links of the Panda press on these people with 80 N and more."""
    episodes = reset_episodes("Panda", CROWDED_WORLDS)
    expert = episodes.task.expert(episodes)
    for _ in range(50):
        episodes.step(expert(episodes.observe()))
        assert_array_equal(episodes.get_state().links_force_n, 0.0)


@pytest.mark.parametrize("robot", ["Panda", "Gen3"])
@pytest.mark.fast_cases(1)
def test_an_initial_state_has_the_same_bits_alone_and_among_others(robot: str) -> None:
    together, alone = reset_episodes(robot, [0, 1, 2, 3]), reset_episodes(robot, [2])
    assert_array_equal(
        together.simulation.get_integration_state(2), alone.simulation.get_integration_state(0)
    )
