from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models.cup import DEFAULT_CUP_SHAPE, WATER
from avrgym.models.human import Person
from avrgym.models.scene import MAX_TOOL_CONTACTS
from avrgym.people import distributions
from avrgym.robots.jaco.robot import JACO
from avrgym.simulation.worlds import State
from avrgym.tasks.drinking.reward import DrinkingState
from avrgym.tasks.drinking.task import INITIAL_CUP_QUAT_W
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS
from avrgym.tasks.task import StepResult
from helpers.simulation.worlds import resting_state

DRINKING = TASKS["Drinking"]
LEFT, BACK, UP = np.eye(3)
MOUTH = np.array([0.0, -0.1, 1.2])
EDGE = np.array([-0.1, -0.4, 1.1])  # where the cup's pouring edge is, which faces left
CUP_MIDDLE = EDGE + DEFAULT_CUP_SHAPE.axis_x_m * LEFT - 0.5 * DEFAULT_CUP_SHAPE.height_m * UP
IN_THE_AIR = np.array([-0.4, -0.2, 1.15])
FALLEN = np.array([-0.4, -0.2, 0.9])
ON_FLOOR = np.array([-0.8, 0.5, 0.005])
BESIDE_THE_CHEST = np.array([0.0, -0.106, 1.0])  # a capsule of radius 0.1 about (0, 0, 1), water of 0.005
STILL = np.zeros((1, 7))


def state(water: dict[int, np.ndarray] | None = None, **changes: np.ndarray) -> State:
    """One world at rest, all water in the middle of an upright cup but the given spheres."""
    spheres = np.tile(CUP_MIDDLE, (64, 1))
    for index, place in (water or {}).items():
        spheres[index] = place
    given = {
        "robot_torso_pos_w": np.array([[-0.35, -0.3, 0.36]]),
        "tool_pos_w": EDGE[None],
        "head_pos_w": np.array([[0.0, 0.03, 1.25]]),
        "mouth_pos_w": MOUTH[None],
        "particle_pos_w": spheres[None],
        "particle_velocity_w": np.zeros((1, 64, 3)),
        "person_capsule_ends_w": np.array([[[[-0.1, 0.0, 1.0], [0.1, 0.0, 1.0]]]]),
        "person_radius_m": np.array([[0.1]]),
    }
    return resting_state(**given | changes)


def fresh(count: int = 1) -> DrinkingState:
    return DRINKING.make_initial_task_state(
        distributions.repeat_person(Person(), count), np.zeros((count, DRINKING.num_random_numbers))
    )


def evaluated(seen: State, task_state: DrinkingState | None = None, action: np.ndarray = STILL) -> StepResult:
    return DRINKING.evaluate_step(seen, action, task_state or fresh())


def term(result: StepResult, name: str) -> float:
    return float(result.reward_terms[name][0])


def counts(result: StepResult) -> tuple[float, float, float]:
    """Water that now counts as in the mouth, as spilled and as on the person."""
    return term(result, "water_in_mouth"), term(result, "water_spilled"), term(result, "water_on_person")


def gone(result: StepResult) -> list[int]:
    return np.nonzero(result.removed_particles_mask[0])[0].tolist()


# Water


def test_water_in_the_cup_counts_for_nothing():
    assert counts(evaluated(state())) == (0, 0, 0)


def test_water_in_the_mouth_counts_once_and_leaves_the_scene():
    seen = state({3: MOUTH + 0.029 * UP})
    result = evaluated(seen)
    assert counts(result) == (1, 0, 0)
    assert result.num_events[0] == 1
    assert gone(result) == [3]
    again = evaluated(seen, result.task_state)
    assert counts(again) == (0, 0, 0)
    assert gone(again) == []


def test_the_mouth_is_three_centimetres_wide():
    assert counts(evaluated(state({0: MOUTH + 0.0301 * UP}))) == (0, 0, 0)
    assert counts(evaluated(state({0: MOUTH + 0.0299 * LEFT}))) == (1, 0, 0)


def test_water_is_drunk_only_once_it_is_out_of_the_cup():
    """The mouth is at the edge of the rim; the water is just below the rim, above it, or beside the wall."""
    at_rim = {"mouth_pos_w": EDGE[None]}
    for place, drunk in ((-0.01 * LEFT - 0.002 * UP, 0), (-0.01 * LEFT + 0.002 * UP, 1), (0.002 * LEFT, 1)):
        assert counts(evaluated(state({0: EDGE + place}, **at_rim))) == (drunk, 0, 0)


def test_the_cup_is_where_the_tool_has_turned_it():
    """Lying down, its opening to the left: the cup's water is to the right of its edge, at most 94 mm above."""
    lying = transforms.from_axis_angle(BACK, 0.5 * np.pi)[None]
    inside, outside = EDGE - 0.05 * LEFT + 0.05 * UP, EDGE + 0.005 * LEFT + 0.01 * UP
    seen = state({}, tool_quat_w=lying, mouth_pos_w=EDGE[None])
    for place, drunk in ((inside, 0), (outside, 64)):
        assert counts(evaluated(replace(seen, particle_pos_w=np.tile(place, (1, 64, 1))))) == (drunk, 0, 0)


def test_water_below_cup_and_mouth_is_spilled_once():
    result = evaluated(state({5: FALLEN}))
    assert counts(result) == (0, 1, 0)
    assert result.num_events[0] == 0
    assert gone(result) == []
    assert counts(evaluated(state({5: FALLEN}), result.task_state)) == (0, 0, 0)


def test_water_that_may_still_reach_cup_or_mouth_is_not_spilled():
    assert counts(evaluated(state({0: IN_THE_AIR}))) == (0, 0, 0)
    for high in ({"tool_pos_w": np.array([[-0.1, -0.4, 0.95]])}, {"mouth_pos_w": MOUTH[None] - 0.32 * UP}):
        assert counts(evaluated(state({**dict.fromkeys(range(64), MOUTH + UP), 0: FALLEN}, **high))) == (
            0,
            0,
            0,
        )


def test_water_on_the_floor_leaves_the_scene_once():
    falling = evaluated(state({2: FALLEN}))
    landed = evaluated(state({2: ON_FLOOR}), falling.task_state)
    assert counts(landed) == (0, 0, 0)
    assert gone(landed) == [2]
    assert gone(evaluated(state({2: ON_FLOOR}), landed.task_state)) == []
    assert counts(evaluated(state({2: ON_FLOOR}))) == (0, 1, 0)


def test_drunk_water_is_never_spilled_and_spilled_water_never_drunk():
    drunk = evaluated(state({0: MOUTH})).task_state
    assert counts(evaluated(state({0: ON_FLOOR}), drunk)) == (0, 0, 0)
    spilled = evaluated(state({0: FALLEN})).task_state
    assert counts(evaluated(state({0: MOUTH}), spilled)) == (0, 0, 0)


def test_water_that_hits_the_person_counts_once():
    result = evaluated(state({1: BESIDE_THE_CHEST, 2: BESIDE_THE_CHEST - 0.003 * BACK}))
    assert term(result, "water_on_person") == 1
    assert term(evaluated(state({1: BESIDE_THE_CHEST}), result.task_state), "water_on_person") == 0


def test_spilled_water_may_still_hit_the_person():
    spilled = evaluated(state({1: FALLEN}))
    assert counts(evaluated(state({1: BESIDE_THE_CHEST}), spilled.task_state)) == (0, 0, 1)


def test_water_in_mouth_or_cup_is_not_on_the_person():
    for place in (MOUTH, CUP_MIDDLE):
        touched = state({0: place}, person_capsule_ends_w=np.tile(place, (1, 1, 2, 1)))
        assert term(evaluated(touched), "water_on_person") == 0


def test_the_speed_of_water_that_enters_the_mouth_adds_up():
    velocity = np.zeros((1, 64, 3))
    velocity[0, :3] = [[0.3, 0.0, 0.4], [0.0, 0.0, 2.0], [0.0, 1.0, 0.0]]
    result = evaluated(state({0: MOUTH, 2: MOUTH}, particle_velocity_w=velocity))
    assert term(result, "water_entry_speed_m_s") == pytest.approx(0.5 + 1.0)


def test_three_quarters_of_the_water_are_a_success():
    """Over any number of steps, and it lasts."""
    first = evaluated(state(dict.fromkeys(range(47), MOUTH)))
    assert not first.success[0]
    second = evaluated(state({60: MOUTH}), first.task_state)
    assert second.success[0]
    assert evaluated(state(), second.task_state).success[0]


# The other terms


def test_distance_is_from_the_pouring_edge_to_the_mouth():
    result = evaluated(state())
    assert term(result, "distance_m") == result.distance_m[0] == pytest.approx(np.linalg.norm(EDGE - MOUTH))


@pytest.mark.parametrize("axis", [LEFT, BACK, transforms.normalize([1.0, 2.0, 0.0])])
@pytest.mark.parametrize("from_horizontal_rad", [0.0, 0.03, 0.4, 1.5, 0.5 * np.pi])
def test_a_cup_may_be_as_far_above_horizontal_as_below(axis, from_horizontal_rad):
    turned = transforms.from_axis_angle(UP, 0.7)
    for sign in (-1.0, 1.0):
        tilt = transforms.from_axis_angle(axis, 0.5 * np.pi + sign * from_horizontal_rad)
        seen = state(tool_quat_w=transforms.multiply(tilt, turned)[None])
        assert term(evaluated(seen), "off_horizontal_rad") == pytest.approx(from_horizontal_rad, abs=1e-7)


def test_no_tilt_is_rewarded_beyond_a_cup_that_lies(rng):
    """Of any rotation the term lies between nothing and a quarter turn, and costs."""
    for q_w in transforms.normalize(rng.normal(size=(200, 4))):
        assert 0.0 <= term(evaluated(state(tool_quat_w=q_w[None])), "off_horizontal_rad") <= 0.5 * np.pi
    assert DRINKING.reward_weights["off_horizontal_rad"] < 0.0


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
    assert DRINKING.reward_weights == {
        "distance_m": -1.0,
        "action_squared": -0.01,
        "off_horizontal_rad": -0.1,
        "water_in_mouth": 10.0,
        "water_spilled": -1.0,
        "tool_speed_m_s": -0.25,
        "strong_tool_force_n": -0.05,
        "links_force_n": -0.01,
        "water_on_person": -1.0,
        "water_entry_speed_m_s": -1.0,
    }


def test_the_reward_is_the_weighted_sum():
    seen = state(
        {0: MOUTH, 1: MOUTH, 2: FALLEN, 3: BESIDE_THE_CHEST},
        particle_velocity_w=np.full((1, 64, 3), 0.1),
        tool_quat_w=transforms.from_axis_angle(LEFT, 0.1)[None],
        tool_velocity_w=np.array([[0.0, 0.2, 0.0]]),
        links_force_n=np.array([7.0]),
        tool_contact_force_n=np.array([[9.0, 4.0, 0.0, 0.0, 0.0, 0.0]]),
    )
    result = evaluated(seen, action=np.full((1, 7), 0.5))
    assert counts(result) == (2, 1, 1)
    distance, entry = np.linalg.norm(EDGE - MOUTH), 2 * np.linalg.norm([0.1] * 3)
    expected = (
        -distance
        - 0.01 * 7 * 0.25
        - 0.1 * (0.5 * np.pi - 0.1)
        + 2 * 10
        - 1
        - 0.25 * 0.2
        - 0.05 * 13
        - 0.01 * 7
        - 1
        - entry
    )
    assert DRINKING.compute_reward(result.reward_terms)[0] == pytest.approx(expected)
    assert set(result.reward_terms) == set(DRINKING.reward_weights)


def test_worlds_are_evaluated_independently():
    worlds = [state({0: MOUTH}), state({0: FALLEN}), state()]
    names = [name for name in vars(worlds[0]) if name != "furniture_pos_w"]
    arrays = {name: np.concatenate([getattr(world, name) for world in worlds]) for name in names}
    result = DRINKING.evaluate_step(State(**arrays, furniture_pos_w={}), np.zeros((3, 7)), fresh(3))
    assert_array_equal(result.reward_terms["water_in_mouth"], [1, 0, 0])
    assert_array_equal(result.reward_terms["water_spilled"], [0, 1, 0])


# Observation


def test_the_observation_has_the_documented_order():
    """Tool − torso, tool rotation, tool − mouth, arm angles, head − torso, head rotation, force at the tool."""
    tool_q, head_q = transforms.normalize([[1.0, 2, 3, 4]]), transforms.normalize([[4.0, 3, 2, 1]])
    seen = state(
        joint_positions=np.arange(7.0)[None],
        tool_quat_w=tool_q,
        head_quat_w=head_q,
        tool_force_n=np.array([9.0]),
    )
    torso = seen.robot_torso_pos_w[0]
    expected = np.concatenate(
        [EDGE - torso, tool_q[0], EDGE - MOUTH, np.arange(7.0), seen.head_pos_w[0] - torso, head_q[0], [9.0]]
    )
    observation = DRINKING.make_observation_spec(DRINKING.make_scene(JACO))
    assert_allclose(observation.compute(seen, fresh()), expected[None])
    assert [entry.size for entry in observation.entries] == [3, 4, 3, 7, 3, 4, 1]


# Cup


def test_water_begins_inside_the_cup_without_overlap():
    assert WATER.initial_pos.shape == (64, 3)
    apart = np.linalg.norm(WATER.initial_pos[:, None] - WATER.initial_pos, axis=-1)[~np.eye(64, dtype=bool)]
    assert apart.min() >= 2.0 * WATER.radius_m
    for x, y, z in WATER.initial_pos:
        assert np.hypot(
            x - DEFAULT_CUP_SHAPE.axis_x_m, y
        ) + WATER.radius_m < DEFAULT_CUP_SHAPE.compute_inner_radius_m(z)
        assert -DEFAULT_CUP_SHAPE.height_m < z - WATER.radius_m < 0.0
    assert (DEFAULT_CUP_SHAPE.rim_radius_m, DEFAULT_CUP_SHAPE.height_m) == (0.047, 0.125)


def reset_episodes(count: int, robot: str = "Jaco") -> Episodes:
    episodes = Episodes(f"avrgym/Drinking{robot}-v1", count, people="revised", num_threads=1)
    episodes.reset(np.arange(count), [np.random.default_rng(i) for i in range(count)])
    return episodes


def in_cup_frame(episodes: Episodes) -> np.ndarray:
    """The water (N, 64, 3) in the cup's frame."""
    seen = episodes.simulation.get_state()
    offset = seen.particle_pos_w - seen.tool_pos_w[:, None]
    return transforms.rotate(transforms.conjugate(seen.tool_quat_w)[:, None], offset)


def test_water_stays_in_a_cup_that_is_carried_fast():
    """Joints swing to and fro at half speed for six seconds; the cup never tilts enough to pour."""
    episodes = reset_episodes(4)
    for step in range(60):
        action = 0.5 * np.cos(0.1 * np.pi * step) * np.array([1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        result = episodes.step(np.tile(action, (4, 1)))
        assert (in_cup_frame(episodes)[..., 2] < -0.02).all()
        assert (
            np.abs(in_cup_frame(episodes)[..., :2] - [DEFAULT_CUP_SHAPE.axis_x_m, 0.0]).max()
            < DEFAULT_CUP_SHAPE.rim_radius_m
        )
        assert not result.reward_terms["water_spilled"].any()


def test_a_cup_that_is_turned_over_spills_every_sphere_once():
    episodes = reset_episodes(2)
    spilled, drunk = np.zeros(2), np.zeros(2)
    for _ in range(60):
        step = episodes.step(np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], (2, 1)))
        spilled += step.reward_terms["water_spilled"]
        drunk += step.reward_terms["water_in_mouth"]
    assert_array_equal(spilled, 64.0)
    assert_array_equal(drunk, 0.0)
    assert_touch_nothing(episodes, on_floor(episodes))


def on_floor(episodes: Episodes) -> list[set[str]]:
    """By world, the spheres that fell to the floor and were taken away."""
    away = np.abs(episodes.simulation.get_state().particle_pos_w[..., 0]) > 2.0
    assert away.sum() > 100
    return [{WATER.bodies[k] for k in np.nonzero(world)[0]} for world in away]


def assert_touch_nothing(episodes: Episodes, spheres: list[set[str]]) -> None:
    simulation = episodes.simulation
    for world, names in enumerate(spheres):
        contact = simulation.batch.get_data(world).contact.geom.ravel()
        assert not names & {simulation.model.geom(geom).name for geom in contact}


# Start and success


@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_episodes_begin_before_the_person_with_an_upright_cup(robot):
    episodes = reset_episodes(32, robot)
    seen = episodes.simulation.get_state()
    hand = seen.tool_pos_w + transforms.rotate(seen.tool_quat_w, episodes.scene.tool.grip_pos)
    offset = hand - [-0.2, -0.5, 1.0]
    assert np.abs(offset).max() <= 0.05 + 0.01
    assert np.abs(offset).max(axis=0).min() > 0.04
    assert_allclose(transforms.angle_between(seen.tool_quat_w, INITIAL_CUP_QUAT_W), 0.0, atol=0.05)
    assert_allclose(transforms.rotate(INITIAL_CUP_QUAT_W, [1.0, 0.0, 0.0]), BACK, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["Jaco", "PR2"])
def test_the_expert_succeeds_in_drinking(robot):
    episodes = reset_episodes(3, robot)
    act = episodes.task.expert(episodes)
    success, observation = np.zeros(3, dtype=bool), episodes.observe()
    for _ in range(120):
        step = episodes.step(act(observation))
        success, observation = step.success, step.observation
    assert success.all()
