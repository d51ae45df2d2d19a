from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models.furniture import BOWL_BODY
from avrgym.models.human import Person
from avrgym.models.scene import MAX_TOOL_CONTACTS
from avrgym.people import distributions
from avrgym.robots.jaco.robot import JACO
from avrgym.simulation.worlds import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.feeding.reward import FeedingState
from avrgym.tasks.feeding.task import INITIAL_SPOON_QUAT_W
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.tasks.task import StepResult
from helpers.simulation.worlds import resting_state

FEEDING = TASKS["Feeding"]
LEFT, _, UP = np.eye(3)
MOUTH = np.array([0.0, -0.1, 1.2])
SPOON = np.array([-0.1, -0.5, 1.1])
BOWL = np.array([-0.15, -0.55, 0.75])
ON_TABLE = np.array([0.4, -0.9, 0.755])
IN_BOWL = BOWL + 0.03 * LEFT + 0.03 * UP
ON_FLOOR = np.array([-0.8, 0.5, 0.005])
IN_THE_AIR = np.array([-0.4, -0.2, 0.9])
BESIDE_THE_CHEST = np.array([0.0, -0.106, 1.0])  # a capsule of radius 0.1 about (0, 0, 1), food of 0.005
STILL = np.zeros((1, 7))


def state(food: dict[int, np.ndarray] | None = None, **changes: np.ndarray) -> State:
    """One world at rest, all food on the spoon but the pieces given."""
    pieces = np.tile(SPOON, (8, 1))
    for index, place in (food or {}).items():
        pieces[index] = place
    given = {
        "robot_torso_pos_w": np.array([[-0.35, -0.3, 0.36]]),
        "tool_pos_w": SPOON[None],
        "head_pos_w": np.array([[0.0, 0.03, 1.25]]),
        "mouth_pos_w": MOUTH[None],
        "furniture_pos_w": {BOWL_BODY: BOWL[None]},
        "particle_pos_w": pieces[None],
        "particle_velocity_w": np.zeros((1, 8, 3)),
        "person_capsule_ends_w": np.array([[[[-0.1, 0.0, 1.0], [0.1, 0.0, 1.0]]]]),
        "person_radius_m": np.array([[0.1]]),
    }
    return resting_state(**given | changes)


def fresh(count: int = 1) -> FeedingState:
    return FEEDING.make_initial_task_state(
        distributions.repeat_person(Person(), count), np.zeros((count, FEEDING.num_random_numbers))
    )


def evaluated(seen: State, task_state: FeedingState | None = None, action: np.ndarray = STILL) -> StepResult:
    return FEEDING.evaluate_step(seen, action, task_state or fresh())


def term(result: StepResult, name: str) -> float:
    return float(result.reward_terms[name][0])


def counts(result: StepResult) -> tuple[float, float, float]:
    """Food that now counts as in the mouth, as dropped and as on the person."""
    return term(result, "food_in_mouth"), term(result, "food_dropped"), term(result, "food_on_person")


# Food


def test_food_on_the_spoon_counts_for_nothing():
    assert counts(evaluated(state())) == (0, 0, 0)


def test_food_in_the_mouth_counts_once_and_leaves_the_task():
    seen = state({3: MOUTH + 0.019 * UP})
    result = evaluated(seen)
    assert counts(result) == (1, 0, 0)
    assert result.num_events[0] == 1
    assert_array_equal(np.nonzero(result.removed_particles_mask[0])[0], [3])
    again = evaluated(seen, result.task_state)
    assert counts(again) == (0, 0, 0)
    assert not again.removed_particles_mask.any()


def test_the_mouth_is_two_centimetres_wide():
    assert counts(evaluated(state({0: MOUTH + 0.0201 * UP}))) == (0, 0, 0)
    assert counts(evaluated(state({0: MOUTH + 0.0199 * LEFT}))) == (1, 0, 0)


@pytest.mark.parametrize("place", [ON_TABLE, IN_BOWL, ON_FLOOR, np.array([0.0, -0.2, 0.499])])
def test_dropped_food_counts_once(place):
    result = evaluated(state({5: place}))
    assert counts(result) == (0, 1, 0)
    assert result.num_events[0] == 0
    assert counts(evaluated(state({5: place}), result.task_state)) == (0, 0, 0)
    assert result.removed_particles_mask.sum() == (place[2] < 0.03)


def test_food_in_the_air_above_table_and_bowl_is_not_dropped():
    for place in (
        IN_THE_AIR,
        ON_TABLE + 0.02 * UP,
        BOWL + 0.08 * UP,
        np.array([0.0, -0.2, 0.501]),
    ):
        assert counts(evaluated(state({0: place}))) == (0, 0, 0)


def test_eaten_food_is_never_dropped_and_dropped_food_never_eaten():
    eaten = evaluated(state({0: MOUTH})).task_state
    assert counts(evaluated(state({0: ON_FLOOR}), eaten)) == (0, 0, 0)
    dropped = evaluated(state({0: ON_TABLE})).task_state
    assert counts(evaluated(state({0: MOUTH}), dropped)) == (0, 0, 0)


def test_food_that_touches_the_person_counts_once():
    result = evaluated(state({1: BESIDE_THE_CHEST, 2: BESIDE_THE_CHEST - [0.0, 0.003, 0.0]}))
    assert counts(result) == (0, 0, 1)
    assert counts(evaluated(state({1: BESIDE_THE_CHEST}), result.task_state)) == (0, 0, 0)
    assert counts(evaluated(state({1: MOUTH}), result.task_state)) == (1, 0, 0)


def test_food_in_the_mouth_is_not_on_the_person():
    face = replace(state({0: MOUTH}), person_capsule_ends_w=np.tile(MOUTH, (1, 1, 2, 1)))
    assert counts(evaluated(face)) == (1, 0, 0)


def test_the_speed_of_food_that_enters_the_mouth_adds_up():
    velocity = np.zeros((1, 8, 3))
    velocity[0, :3] = [[0.3, 0.0, 0.4], [0.0, 0.0, 2.0], [0.0, 1.0, 0.0]]
    result = evaluated(state({0: MOUTH, 2: MOUTH}, particle_velocity_w=velocity))
    assert term(result, "food_entry_speed_m_s") == pytest.approx(0.5 + 1.0)


def test_six_of_eight_pieces_are_a_success():
    """Over any number of steps, and it lasts."""
    five = evaluated(state(dict.fromkeys(range(5), MOUTH)))
    assert not five.success[0]
    six = evaluated(state({6: MOUTH}), five.task_state)
    assert six.success[0]
    assert evaluated(state(), six.task_state).success[0]


# The other terms


def test_distance_is_from_spoon_to_mouth():
    result = evaluated(state())
    assert term(result, "distance_m") == result.distance_m[0] == pytest.approx(np.linalg.norm(SPOON - MOUTH))


def test_action_speed_and_force_terms():
    seen = state(
        tool_velocity_w=np.array([[0.3, 0.0, -0.4]]),
        links_force_n=np.array([12.0]),
        total_force_n=np.array([15.0]),
    )
    result = evaluated(seen, action=np.array([[1.0, -0.5, 0.0, 0.0, 0.0, 0.0, 0.5]]))
    assert term(result, "action_squared") == 1.5
    assert term(result, "tool_speed_m_s") == pytest.approx(0.5)
    assert term(result, "links_force_n") == 12.0
    assert result.force_on_person_n[0] == 15.0


@pytest.mark.parametrize("places", [1, 3])
@pytest.mark.parametrize(
    ("newtons", "strong"), [(0.0, 0.0), (9.9, 0.0), (10.0, 10.0), (25.0, 25.0), (50.0, 50.0)]
)
def test_the_tool_presses_strongly_from_ten_newtons_in_all(newtons, strong, places):
    """Nothing below, the whole force from there on; what the links press with is another term."""
    forces = np.zeros((1, MAX_TOOL_CONTACTS))
    forces[0, :places] = newtons / places
    result = evaluated(state(tool_contact_force_n=forces, links_force_n=np.array([30.0])))
    assert term(result, "strong_tool_force_n") == pytest.approx(strong)
    assert term(result, "links_force_n") == 30.0


def test_the_weights_are_those_of_the_paper():
    assert FEEDING.reward_weights == {
        "distance_m": -1.0,
        "action_squared": -0.01,
        "food_in_mouth": 20.0,
        "food_dropped": -5.0,
        "tool_speed_m_s": -0.25,
        "strong_tool_force_n": -0.05,
        "links_force_n": -0.01,
        "food_on_person": -1.0,
        "food_entry_speed_m_s": -1.0,
    }


def test_the_reward_is_the_weighted_sum():
    velocity = np.full((1, 8, 3), 0.1)
    seen = state(
        {0: MOUTH, 1: MOUTH, 2: ON_TABLE, 3: BESIDE_THE_CHEST},
        particle_velocity_w=velocity,
        tool_velocity_w=np.array([[0.0, 0.2, 0.0]]),
        links_force_n=np.array([7.0]),
        tool_contact_force_n=np.array([[9.0, 4.0, 0.0, 0.0, 0.0, 0.0]]),
    )
    result = evaluated(seen, action=np.full((1, 7), 0.5))
    distance, entry = np.linalg.norm(SPOON - MOUTH), 2 * np.linalg.norm([0.1] * 3)
    expected = -distance - 0.01 * 7 * 0.25 + 2 * 20 - 5 - 0.25 * 0.2 - 0.05 * 13 - 0.01 * 7 - 1 - entry
    assert FEEDING.compute_reward(result.reward_terms)[0] == pytest.approx(expected)
    assert set(result.reward_terms) == set(FEEDING.reward_weights)


def test_worlds_are_evaluated_independently():
    worlds = [state({0: MOUTH}), state({0: ON_TABLE}), state()]
    stacked = replace(
        worlds[0],
        particle_pos_w=np.concatenate([world.particle_pos_w for world in worlds]),
        particle_velocity_w=np.zeros((3, 8, 3)),
        tool_pos_w=np.tile(SPOON, (3, 1)),
        mouth_pos_w=np.tile(MOUTH, (3, 1)),
        furniture_pos_w={BOWL_BODY: np.tile(BOWL, (3, 1))},
        person_capsule_ends_w=np.tile(worlds[0].person_capsule_ends_w, (3, 1, 1, 1)),
        person_radius_m=np.full((3, 1), 0.1),
    )
    result = FEEDING.evaluate_step(stacked, np.zeros((3, 7)), fresh(3))
    assert_array_equal(result.reward_terms["food_in_mouth"], [1, 0, 0])
    assert_array_equal(result.reward_terms["food_dropped"], [0, 1, 0])


# Observation


def test_the_observation_has_the_documented_order():
    """Tool − base, tool rotation, tool − mouth, arm angles, head − base, head rotation, force at the tool."""
    tool_q, head_q = (
        transforms.normalize([[1.0, 2.0, 3.0, 4.0]]),
        transforms.normalize([[4.0, 3.0, 2.0, 1.0]]),
    )
    seen = state(
        joint_positions=np.arange(7.0)[None],
        tool_quat_w=tool_q,
        head_quat_w=head_q,
        tool_force_n=np.array([9.0]),
    )
    base = seen.robot_torso_pos_w[0]
    expected = np.concatenate(
        [SPOON - base, tool_q[0], SPOON - MOUTH, np.arange(7.0), seen.head_pos_w[0] - base, head_q[0], [9.0]]
    )
    observation = FEEDING.make_observation_spec(FEEDING.make_scene(JACO))
    assert_allclose(observation.compute(seen, fresh()), expected[None])
    assert observation.size == len(expected) == 25
    assert [entry.size for entry in observation.entries] == [3, 4, 3, 7, 3, 4, 1]


# Start


def test_episodes_begin_above_the_bowl_with_a_level_spoon():
    episodes = Episodes("avrgym/FeedingJaco-v1", 64, people="revised", num_threads=1)
    episodes.reset(np.arange(64), [np.random.default_rng(i) for i in range(64)])
    seen = episodes.simulation.get_state()
    bowl = seen.furniture_pos_w[BOWL_BODY] - [-0.15, -0.55, 0.75]
    assert np.abs(bowl).max() <= 0.05
    assert np.abs(bowl).max(axis=0).min() > 0.04
    hand = seen.tool_pos_w + transforms.rotate(seen.tool_quat_w, episodes.scene.tool.grip_pos)
    from_bowl = hand - seen.furniture_pos_w[BOWL_BODY] - [0.0, -0.1, 0.4]
    assert np.abs(from_bowl).max() <= 0.05 + 0.01
    assert_allclose(transforms.angle_between(seen.tool_quat_w, INITIAL_SPOON_QUAT_W), 0.0, atol=0.05)
    assert_allclose(transforms.rotate(INITIAL_SPOON_QUAT_W, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0], atol=1e-12)


def test_a_start_says_where_the_bowl_is(rng, feeding_scene):
    uniforms = rng.random((3, FEEDING.num_random_numbers))
    start = FEEDING.sample_initial_states(feeding_scene, distributions.repeat_person(Person(), 3), uniforms)
    assert_allclose(
        start.furniture_pos_w[BOWL_BODY], np.array([-0.15, -0.55, 0.75]) + 0.1 * (uniforms[:, :3] - 0.5)
    )


def test_an_unknown_environment_lists_the_environments():
    with pytest.raises(ValueError, match=r"unknown environment 'avrgym/Flying-v1'; .*avrgym/FeedingJaco-v1"):
        find_environment("avrgym/Flying-v1")
