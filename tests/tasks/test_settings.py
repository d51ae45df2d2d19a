"""Settings of environments: impossible values are rejected; others are applied and stored; defaults change nothing."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
import msgspec
import numpy as np
import pytest

from avrgym.models.collision_bits import FURNITURE
from avrgym.models.human import BODIES, PERSON_NAME_PREFIX, Person
from avrgym.models.scene import CONTROL_STEP_S, DEFAULT_SUBSTEPS
from avrgym.policies import registry
from avrgym.policies.trained_policies import PolicyError
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.system import random_streams
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import TASKS, find_task_and_scene
from avrgym.tasks.settings import (
    CONTROL_RATES_HZ,
    DEFAULT_SETTINGS,
    Settings,
    make_settings,
    parse_settings,
)

FEEDING = "avrgym/FeedingJaco-v1"
CHANGED: Mapping[str, Any] = {
    "control_hz": 20,
    "tool": "large",
    "particles": 5,
    "table_offset_m": [0.1, 0.0, -0.05],
    "robot_pose": [-0.8, -0.4, 10.0],
    "served_arm": "left",
    "seat_height_m": 0.55,
    "bed_height_m": 0.65,
    "backrest_deg": 45.0,
    "torso_height_m": [0.5, 0.6],
    "body_mass_kg": 90.0,
    "range_share": 0.7,
    "standing_by": [["PR2", 1.5, -1.0, 90.0]],
    "self_collision": True,
}
"""A changed value of each setting."""
IMPOSSIBLE: Mapping[str, Any] = {
    "control_hz": 7,
    "tool": "fork",
    "particles": 0,
    "table_offset_m": [1.0, 0.0, 0.0],
    "robot_pose": [9.0, 0.0, 0.0],
    "served_arm": "both",
    "seat_height_m": 0.9,
    "bed_height_m": 0.2,
    "backrest_deg": 10.0,
    "torso_height_m": [0.6, 0.5],
    "body_mass_kg": 5.0,
    "range_share": 1.5,
    "standing_by": [["R2D2", 0.0, 0.0, 0.0]],
    "self_collision": "maybe",
}


def test_every_setting_has_an_example() -> None:
    assert set(CHANGED) == set(IMPOSSIBLE) == set(Settings.__struct_fields__)


@pytest.mark.parametrize("name", CHANGED)
def test_settings_survive_storage(name: str) -> None:
    settings = make_settings({name: CHANGED[name]})
    assert settings != DEFAULT_SETTINGS
    assert msgspec.json.decode(msgspec.json.encode(settings), type=Settings) == settings
    assert make_settings(settings.changed_values) == settings


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_an_impossible_setting_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}|unknown size of spoon|unknown robot 'R2D2'"):
        find_task_and_scene(FEEDING, make_settings({name: IMPOSSIBLE[name]}))


def test_defaults_are_stored_as_nothing() -> None:
    assert msgspec.json.encode(DEFAULT_SETTINGS) == b"{}"


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("control_hz", "allowed: name=value"),
        ("speed=2", "allowed: control_hz"),
        ("control_hz=fast", "Expected `int`"),
    ],
)
def test_a_wrong_line_is_refused(line: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        parse_settings([line])


def test_environments_take_settings_as_keyword_arguments() -> None:
    env = gym.make(FEEDING, control_hz=20, max_episode_steps=3)
    assert env.metadata["render_fps"] == 20
    assert gym.make(env.spec).unwrapped.episodes.settings == Settings(control_hz=20)  # type: ignore[attr-defined, arg-type]
    with pytest.raises(ValueError, match="unknown setting control_rate"):
        gym.make(FEEDING, control_rate=20)


@pytest.mark.parametrize("control_hz", CONTROL_RATES_HZ)
def test_a_control_step_lasts_as_long_as_the_rate_requires(control_hz: int) -> None:
    episodes = begun(control_hz)
    before_s = episodes.simulation.batch.get_data(0).time
    episodes.step(np.zeros((1, episodes.action_size)))
    assert episodes.simulation.batch.get_data(0).time - before_s == pytest.approx(1.0 / control_hz)


@pytest.mark.parametrize("people", ["participants", "zoo/train"])
def test_people_and_robot_move_alike_at_every_rate(people: str) -> None:
    """With constant actions, worlds of every rate pass through the same states."""
    seconds, states = 0.6, {}
    for control_hz in CONTROL_RATES_HZ:
        episodes = begun(control_hz, people=people, impairment="tremor")
        for _ in range(round(seconds * control_hz)):
            episodes.step(np.full((1, episodes.action_size), 0.1))
        states[control_hz] = episodes.simulation.get_person_joint_angles_rad()[0]
    for control_hz in CONTROL_RATES_HZ:
        np.testing.assert_array_equal(states[control_hz], states[10], f"{control_hz} Hz")


def test_people_of_a_world_do_not_depend_on_other_worlds() -> None:
    """Worlds begin episodes between two targets of the people in other worlds."""
    alone, together = (
        begun(20, people="zoo/train"),
        Episodes(FEEDING, 2, people="zoo/train", num_threads=1, settings=Settings(control_hz=20)),
    )
    action = np.zeros((1, alone.action_size))
    together.reset(np.array([0, 1]), [random_streams.make_episode_rng(seed) for seed in (0, 1)])
    together.step(np.repeat(action, 2, axis=0))
    together.reset(np.array([1]), [random_streams.make_episode_rng(0)])
    for _ in range(5):
        together.step(np.repeat(action, 2, axis=0))
        alone.step(action)
    np.testing.assert_array_equal(
        together.simulation.get_person_joint_angles_rad()[1],
        alone.simulation.get_person_joint_angles_rad()[0],
    )


@pytest.mark.parametrize("control_hz", [5, 50])
def test_ticks_and_whole_steps_give_the_same_bits(control_hz: int) -> None:
    whole, ticked = begun(control_hz, people="zoo/train"), begun(control_hz, people="zoo/train")
    source = Constant(np.full((1, whole.action_size), 0.2))
    for _ in range(3):
        whole.step(source.action)
        steps = [ticked.control_loop.tick(source) for _ in range(ticked.scene.substeps)]
        assert [step is None for step in steps] == [True] * (len(steps) - 1) + [False]
        assert (
            whole.simulation.get_integration_state().tobytes()
            == ticked.simulation.get_integration_state().tobytes()
        )


def test_people_that_act_once_a_control_step_refuse_other_rates() -> None:
    with pytest.raises(ValueError, match="control_hz=10"):
        Episodes(FEEDING, 1, human_actions=True, settings=Settings(control_hz=20))


def test_packaged_policies_refuse_settings_of_no_training() -> None:
    with pytest.raises(PolicyError, match="trained with default settings, not with control_hz=20"):
        registry.resolve_policy("revised", FEEDING, Settings(control_hz=20))
    assert registry.resolve_policy("revised", FEEDING, Settings(control_hz=20), allow_other_settings=True)
    assert registry.resolve_policy("oracle", FEEDING, Settings(control_hz=20))


def test_the_default_control_step_is_that_of_people() -> None:
    assert DEFAULT_SETTINGS.control_step_s == CONTROL_STEP_S
    assert begun(10).scene.substeps == DEFAULT_SUBSTEPS


TOOLS = [
    ("Feeding", "small", 3),
    ("Feeding", "large", 10),
    ("Drinking", "glass", 100),
    ("Drinking", "mug", 16),
]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("task", "tool", "particles"), TOOLS)
def test_every_particle_of_every_tool_stays_in_it(task: str, tool: str, particles: int) -> None:
    """The robot holds the tool level for a second; its expert can then begin."""
    settings = Settings(tool=tool, particles=particles)
    episodes = Episodes(f"avrgym/{task}Jaco-v1", 1, num_threads=1, settings=settings)
    episodes.reset(np.array([0]), [random_streams.make_episode_rng(0)])
    for _ in range(10):
        step = episodes.step(np.zeros((1, episodes.action_size)))
    assert episodes.simulation.get_state().particle_pos_w.shape == (1, particles, 3)
    lost = [name for name in ("food_dropped", "water_spilled") if name in step.reward_terms]
    assert [step.reward_terms[name][0] for name in lost] == [0.0]
    tool_w = episodes.simulation.get_state().tool_pos_w
    assert (
        np.linalg.norm(episodes.simulation.get_state().particle_pos_w - tool_w[:, None], axis=-1).max() < 0.2
    )
    assert np.isfinite(episodes.task.expert(episodes)(step.observation)).all()


@pytest.mark.parametrize(
    ("task", "values", "problem"),
    [
        ("Feeding", {"particles": 9}, "particles is 9; allowed on a medium spoon: 1 to 8"),
        ("Feeding", {"tool": "mug"}, "unknown size of spoon .mug.; allowed: small, medium, large"),
        ("Drinking", {"particles": 1000}, "allowed for a cup: 1 to"),
        ("BedBathing", {"particles": 5}, "BedBathing has no setting 'particles'"),
        ("Drinking", {"table_offset_m": [0.1, 0.0, 0.0]}, "no furniture for the setting table_offset_m"),
        ("Drinking", {"served_arm": "left"}, "Drinking has no setting served_arm"),
        ("Drinking", {"bed_height_m": 0.6}, "no furniture for the setting bed_height_m"),
        ("BedBathing", {"seat_height_m": 0.5}, "no furniture for the setting seat_height_m"),
    ],
)
def test_a_tool_that_a_task_does_not_have_is_refused(task: str, values: dict[str, Any], problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        find_task_and_scene(f"avrgym/{task}Jaco-v1", make_settings(values))


@pytest.mark.parametrize("task", TASKS)
def test_worlds_of_the_same_settings_share_a_scene(task: str) -> None:
    environment = f"avrgym/{task}Jaco-v1"
    assert find_task_and_scene(environment) == (TASKS[task], find_task_and_scene(environment)[1])
    assert find_task_and_scene(environment, Settings(control_hz=20))[0] is TASKS[task]
    assert (
        find_task_and_scene(environment, Settings(control_hz=20))[1]
        is find_task_and_scene(environment, Settings(control_hz=20))[1]
    )


def test_a_chosen_base_replaces_the_search() -> None:
    pose = (-0.8, -0.2, 5.0)
    episodes = Episodes("avrgym/FeedingPR2-v1", 3, num_threads=1, settings=Settings(robot_pose=pose))
    episodes.reset(np.arange(3), [random_streams.make_episode_rng(seed) for seed in range(3)])
    pos_w, q_w = episodes.simulation.get_initial_base_pose()
    np.testing.assert_allclose(pos_w[:, :2], [pose[:2]] * 3)
    np.testing.assert_allclose(2.0 * np.degrees(np.arctan2(q_w[:, 3], q_w[:, 0])), pose[2])


def test_table_bowl_and_hand_move_together() -> None:
    offset_m = (0.05, 0.0, -0.02)
    usual, moved = begun(10), Episodes(FEEDING, 1, num_threads=1, settings=Settings(table_offset_m=offset_m))
    moved.reset(np.array([0]), [random_streams.make_episode_rng(0)])
    for name in ("bowl", "table"):
        places = [
            each.simulation.get_body_poses(0)[each.simulation.bodies.index(name), :3]
            for each in (usual, moved)
        ]
        np.testing.assert_allclose(places[1] - places[0], offset_m, atol=1e-9)
    tools_w = [each.simulation.get_state().tool_pos_w[0] for each in (usual, moved)]
    np.testing.assert_allclose(tools_w[1] - tools_w[0], offset_m, atol=0.02)


@pytest.mark.slow
def test_a_base_out_of_reach_is_refused() -> None:
    settings = Settings(robot_pose=(-3.0, 0.0, 0.0))
    episodes = Episodes("avrgym/FeedingPR2-v1", 1, num_threads=1, settings=settings)
    with pytest.raises(NoClearanceError, match="the arm does not reach"):
        episodes.reset(np.array([0]), [random_streams.make_episode_rng(0)])


def test_drawn_people_have_the_heights_and_ranges_of_the_settings() -> None:
    settings = Settings(torso_height_m=(0.61, 0.62), range_share=0.6)
    episodes = Episodes(FEEDING, 8, people="revised", num_threads=1, settings=settings)
    episodes.reset(np.arange(8), [random_streams.make_episode_rng(seed) for seed in range(8)])
    heights = episodes.people.torso_height_m
    assert (heights >= 0.61).all()
    assert (heights <= 0.62).all()
    assert (episodes.people.range_share == 0.6).all()
    for name in ("torso_height_m", "range_share"):
        with pytest.raises(ValueError, match=f"the setting {name} is not possible with a fixed person"):
            Episodes(FEEDING, 1, person=Person(), settings=make_settings({name: CHANGED[name]}))


@pytest.mark.parametrize("people", ["original", "participants"])
def test_everybody_has_the_mass_of_the_settings(people: str) -> None:
    episodes = Episodes(FEEDING, 2, people=people, num_threads=1, settings=Settings(body_mass_kg=90.0))
    episodes.reset(np.arange(2), [random_streams.make_episode_rng(seed) for seed in range(2)])
    model = episodes.simulation.batch.get_model(1)
    person = [model.body(PERSON_NAME_PREFIX + name).id for name in BODIES]
    assert model.body_mass[person].sum() == pytest.approx(90.0)


@pytest.mark.slow
def test_robots_standing_by_are_obstacles_that_do_not_move() -> None:
    place = (1.5, -1.0)
    settings = Settings(standing_by=(("PR2", *place, 90.0),))
    episodes = Episodes(FEEDING, 1, num_threads=1, settings=settings)
    episodes.reset(np.array([0]), [random_streams.make_episode_rng(0)])
    model, plain = episodes.simulation.model, begun(10).simulation.model
    assert (model.nq, model.nu) == (plain.nq, plain.nu)
    added = [geom for geom in range(model.ngeom) if "standing_by_0" in body_of(model, geom)]
    assert len(added) == model.ngeom - plain.ngeom > 10
    assert {int(model.geom_contype[geom]) for geom in added} == {FURNITURE.contype}
    base = next(name for name in episodes.simulation.bodies if name.startswith("standing_by_0/"))
    pose = episodes.simulation.get_body_poses(0)[episodes.simulation.bodies.index(base)]
    np.testing.assert_allclose(pose[:2], place)
    crowded = Episodes(FEEDING, 1, settings=Settings(standing_by=(("PR2", -0.4, -0.5, 0.0),)))
    with pytest.raises(NoClearanceError):
        crowded.reset(np.array([0]), [random_streams.make_episode_rng(0)])


def body_of(model: Any, geom: int) -> str:
    return model.body(model.geom_bodyid[geom]).name


class Constant:
    """Commands the same action at all times."""

    def __init__(self, action: Any) -> None:
        self.action = action

    def act(self, observation: Any) -> Any:
        return self.action

    def update_action(self) -> None:
        return None


def begun(control_hz: int, people: str = "original", impairment: str = "none") -> Episodes:
    """One world with this control rate, at the start of an episode."""
    episodes = Episodes(
        FEEDING,
        1,
        people=people,
        impairment=impairment,
        num_threads=1,
        settings=Settings(control_hz=control_hz),
    )
    episodes.reset(np.array([0]), [random_streams.make_episode_rng(0)])
    return episodes
