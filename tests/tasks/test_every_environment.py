"""Laws of every environment: the same seed gives the same bits, and the physics is stable."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from avrgym.geometry import transforms
from avrgym.models import human, robot
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.placement import compute_furniture_edge_x_m
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.worlds import assert_finite, jerky_actions

CARRYING = [name for name in ENVIRONMENTS if "Feeding" in name or "Drinking" in name]
ALLOWED_DEPTH_M = 0.03
"""A person gives way under what presses: by 1 cm at 68 N on one point, by 3 cm at 86 N."""
SLACK_M = 0.003


def reset_episodes(
    environment: str, worlds: int, *, people: str = "revised", threads: int = 2, first: int = 0
) -> Episodes:
    episodes = Episodes(environment, worlds, people=people, num_threads=threads)
    episodes.reset(np.arange(worlds), [np.random.default_rng(first + i) for i in range(worlds)])
    return episodes


def assert_same_steps(some: Episodes, many: Episodes, at: int, actions: np.ndarray) -> None:
    """World 0 of ``some`` and world ``at`` of ``many`` see the same bits under the same actions (T, N, 7)."""
    for action in actions:
        one, other = some.step(action[at : at + some.simulation.num_worlds]), many.step(action)
        assert_array_equal(one.observation[0], other.observation[at])
        assert_array_equal(one.reward[0], other.reward[at])


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("people", ["revised", "participants", "zoo/train"])
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_the_number_of_threads_changes_no_bit(environment, people, rng):
    one, two = (reset_episodes(environment, 4, people=people, threads=threads) for threads in (1, 2))
    for action in rng.uniform(-1, 1, (5, 4, one.action_size)):
        first, second = one.step(action), two.step(action)
        assert_array_equal(first.observation, second.observation)
        assert_array_equal(first.reward, second.reward)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_an_episode_is_the_same_alone_and_among_64(environment, rng):
    alone, among = reset_episodes(environment, 1, first=41), reset_episodes(environment, 64)
    assert_same_steps(alone, among, 41, rng.uniform(-1, 1, (4, 64, alone.action_size)))


@pytest.mark.slow
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_random_episodes_stay_finite_without_a_warning(environment, rng):
    assert_finite(reset_episodes(environment, 12), rng, EPISODE_STEPS)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", CARRYING)
def test_what_a_tool_carries_stays_in_it_while_the_arm_is_still(environment):
    episodes = reset_episodes(environment, 8)
    held = np.zeros((8, episodes.action_size))
    for _ in range(10):
        episodes.step(held)
    low, high = on_tool(episodes).min(axis=(0, 1)), on_tool(episodes).max(axis=(0, 1))
    for _ in range(40):
        episodes.step(held)
    assert (on_tool(episodes) > low - SLACK_M).all()
    assert (on_tool(episodes) < high + SLACK_M).all()


def on_tool(episodes: Episodes) -> np.ndarray:
    """Where particles (N, K, 3) are in the frame of the tool."""
    state = episodes.simulation.get_state()
    offset = state.particle_pos_w - state.tool_pos_w[:, None]
    return transforms.rotate(transforms.conjugate(state.tool_quat_w)[:, None], offset)


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_robot_and_person_do_not_pass_through_each_other(environment, rng):
    worlds = 8
    episodes = reset_episodes(environment, worlds)
    deepest = depth(episodes)
    assert deepest <= 0.001, "they begin apart"
    for action in jerky_actions(rng, worlds, 60, episodes.action_size):
        episodes.step(action)
        deepest = max(deepest, depth(episodes))
    assert deepest <= ALLOWED_DEPTH_M


def depth(episodes: Episodes) -> float:
    """How deep, in metres, robot or tool are in a person, over all worlds."""
    simulation = episodes.simulation
    worlds = range(simulation.num_worlds)
    return max(_depth(simulation.model, simulation.batch.get_data(world)) for world in worlds)


def _depth(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    deepest = 0.0
    for contact in data.contact:
        if min(contact.geom) < 0:  # of cloth
            continue
        pair = {
            model.body(model.geom_bodyid[geom]).name.split("/")[0] for geom in (contact.geom1, contact.geom2)
        }
        if pair == {human.PERSON_NAME_PREFIX[:-1], robot.ROBOT_NAME_PREFIX[:-1]}:
            deepest = max(deepest, -float(contact.dist))
    return deepest


@pytest.mark.parametrize("environment", [name for name in ENVIRONMENTS if "PR2" in name])
@pytest.mark.fast_cases(2)
def test_a_mobile_robot_stands_clear_of_wheelchair_and_bed_and_faces_the_person(environment):
    episodes = reset_episodes(environment, 64)
    pos_w, q_w = episodes.simulation.get_initial_base_pose()
    half = episodes.scene.robot.base_half_width_m
    corners = np.array([[x, y, 0.0] for x in (-half, half) for y in (-half, half)])
    reach_w = pos_w[:, None] + transforms.rotate(q_w[:, None], corners)
    to_person = -np.sign(episodes.scene.mount.pos_w[0])
    assert (to_person * reach_w[..., 0] <= compute_furniture_edge_x_m(episodes.scene.posture) + 1e-9).all()
    forward_w = transforms.rotate(q_w, [1.0, 0.0, 0.0])
    assert (to_person * forward_w[:, 0] >= np.cos(np.radians(30.0)) - 1e-9).all()
    assert len(np.unique(pos_w.round(6), axis=0)) > 32
