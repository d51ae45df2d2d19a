import numpy as np
import pytest

from avrgym.geometry.transforms import norm
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.experts.filtered_expert import filter_tremor
from avrgym.tasks.scratch_itch.expert import compute_skin_directions_w
from avrgym.tasks.scratch_itch.feedback_expert import compute_front_approach_weight
from avrgym.tasks.scratch_itch.memory_expert import SWING_BY_ROBOT, SwingToFrontExpert, make_memory_expert
from avrgym.tasks.scratch_itch.reward import compute_itch_limb_frame
from helpers.learning.experts import assert_matches_feedback_expert
from helpers.simulation.itches import forearm_itch

INNER_RAD, OUTER_RAD = np.radians(np.linspace([-165.0, -60.0], [-135.0, 60.0], 8)).T
"""Places on the forearm that face the other arm, and the others, from its outer side."""


def reset_episodes(robot: str, angle_rad: np.ndarray) -> Episodes:
    """Episodes with itches in the middle of the forearm."""
    count = len(angle_rad)
    episodes = Episodes(f"avrgym/ScratchItch{robot}-v1", count, people="revised", num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng([8, i]) for i in range(count)])
    episodes.task_state = forearm_itch(episodes, angle_rad)
    return episodes


@pytest.mark.parametrize("robot", SWING_BY_ROBOT)
@pytest.mark.fast_cases(1)
def test_outer_skin_is_scratched_like_the_feedback_expert(robot):
    assert_matches_feedback_expert(make_memory_expert, reset_episodes(robot, OUTER_RAD), 40)


@pytest.mark.parametrize("robot", SWING_BY_ROBOT)
@pytest.mark.fast_cases(1)
def test_an_arm_swings_in_front_once_before_it_comes_to_the_inner_side(robot):
    episodes = reset_episodes(robot, INNER_RAD)
    patient, reactive = make_memory_expert(episodes), episodes.task.feedback_expert(episodes)
    assert isinstance(patient, SwingToFrontExpert)
    out_w, _ = compute_skin_directions_w(
        episodes.task_state, compute_itch_limb_frame(episodes.get_state(), episodes.task_state)[1]
    )
    assert np.all(
        compute_front_approach_weight(
            out_w, SWING_BY_ROBOT[robot].inward_range, SWING_BY_ROBOT[robot].not_downward_range
        )
        == 1.0
    )
    way_rad, swung = np.array(SWING_BY_ROBOT[robot].joint_displacements), []
    for _ in range(60):
        observation = episodes.observe()
        action = patient(observation)
        if not swung:
            along = (action * way_rad).sum(axis=-1) / (norm(action) * norm(way_rad))
            assert np.all(along > 0.5)
            assert np.abs(action - reactive(observation)).max() > 0.1
        swung.append(patient._swung.copy())
        episodes.step(action)
    assert not swung[0].any()
    assert swung[-1].mean() > 0.7
    assert np.all(np.diff(np.array(swung, dtype=int), axis=0) >= 0)


@pytest.mark.slow
@pytest.mark.parametrize("robot", SWING_BY_ROBOT)
def test_the_inner_side_of_the_forearm_is_scratched_by_an_arm_that_swung_in_front(robot):
    episodes = reset_episodes(robot, INNER_RAD)
    scratches = filter_tremor(make_memory_expert)(episodes)
    for _ in range(EPISODE_STEPS):
        step = episodes.step(scratches(episodes.observe()))
    assert step.success.mean() >= 0.75
