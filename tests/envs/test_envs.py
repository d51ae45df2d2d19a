from collections import Counter

import gymnasium as gym
import mujoco
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from numpy.testing import assert_array_equal

import avrgym
from avrgym.envs.single import AssistiveEnv
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.models.human import Person
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.vector_environments import invalid_actions

FEEDING = "avrgym/FeedingJaco-v1"
EPISODE_STEPS = 200


@pytest.fixture(scope="module")
def graphics() -> None:
    """Skips what needs a graphics library that draws without a screen where there is none."""
    env = AssistiveEnv(FEEDING, render_mode="rgb_array")
    env.reset(seed=0)
    try:
        env.render()
    except RuntimeError:
        pytest.skip("no graphics library draws here")
    env.close()


needs_graphics = pytest.mark.usefixtures("graphics")


# The public surface


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment_id", ENVIRONMENTS)
def test_every_environment_passes_the_checker(environment_id):
    """Warnings are errors here."""
    check_env(gym.make(environment_id).unwrapped, skip_render_check=True)


@pytest.mark.slow
@needs_graphics
@pytest.mark.parametrize("environment_id", {task: name for name, (task, _) in ENVIRONMENTS.items()}.values())
def test_each_task_passes_the_checker_with_pictures(environment_id):
    env = gym.make(environment_id, render_mode="rgb_array")
    check_env(env.unwrapped)
    env.close()


def test_importing_the_package_registers_the_environments():
    assert set(ENVIRONMENTS) <= set(gym.registry)
    assert avrgym.__doc__
    assert isinstance(gym.make("avrgym:avrgym/FeedingJaco-v1").unwrapped, AssistiveEnv)
    assert isinstance(gym.make_vec("avrgym:avrgym/FeedingJaco-v1", num_envs=2).unwrapped, AssistiveVectorEnv)


@pytest.mark.parametrize("environment_id", ENVIRONMENTS)
def test_info_says_success_terms_and_force(environment_id):
    """At the start as later, and of the start what is true there."""
    env = gym.make(environment_id, people="revised")
    assert isinstance(env.unwrapped, AssistiveEnv)
    _, first = env.reset(seed=0)
    state = env.unwrapped.episodes.simulation.get_state()
    later = env.step(np.zeros_like(env.action_space.sample()))[-1]
    for info in (first, later):
        assert set(info) == {"success", "reward_terms", "force_on_person"}
        assert info["success"] is False
        assert isinstance(info["force_on_person"], float)
        assert set(info["reward_terms"]) == set(env.unwrapped.episodes.task.reward_weights)
        assert all(isinstance(value, float) for value in info["reward_terms"].values())
    assert first["reward_terms"]["distance_m"] == pytest.approx(later["reward_terms"]["distance_m"], abs=0.01)
    assert first["reward_terms"]["distance_m"] > 0.1
    assert first["reward_terms"]["tool_speed_m_s"] == pytest.approx(0.0, abs=1e-9)
    assert first["force_on_person"] == state.total_force_n[0]


@pytest.mark.parametrize("make", [gym.make, AssistiveEnv])
def test_an_episode_is_cut_after_20_seconds_and_has_no_201st_step(make):
    assert gym.spec(FEEDING).max_episode_steps == EPISODE_STEPS
    env = make(FEEDING)
    still = np.zeros(7, np.float32)
    with pytest.raises(ResetNeeded):
        env.step(still)
    env.reset(seed=0)
    ends = [env.step(still)[2:4] for _ in range(EPISODE_STEPS)]
    assert ends == [(False, False)] * (EPISODE_STEPS - 1) + [(False, True)]
    before = env.unwrapped.episodes.simulation.get_integration_state()
    with pytest.raises(ResetNeeded, match=r"call reset\(\) to start an episode of 200 steps"):
        env.step(still)
    assert_array_equal(env.unwrapped.episodes.simulation.get_integration_state(), before)
    env.reset()
    assert env.step(still)[2:4] == (False, False)


def test_an_episode_may_be_made_shorter():
    env = gym.make(FEEDING, max_episode_steps=3)
    env.reset(seed=0)
    assert [env.step(np.zeros(7, np.float32))[3] for _ in range(3)] == [False, False, True]


# Actions


@pytest.mark.parametrize("action", invalid_actions((7,)))
def test_an_action_that_is_none_is_refused_before_anything_moves(action, rng):
    """The step after it is the one that would have been, had nobody asked."""
    asked, alone = (gym.make(FEEDING, people="participants") for _ in range(2))
    for env in (asked, alone):
        env.reset(seed=1)
    with pytest.raises(ValueError, match=r"allowed: finite numbers of shape \(7,\), -1 to 1"):
        asked.step(action)
    for useful in rng.uniform(-1, 1, (3, 7)).astype(np.float32):
        both = [env.step(useful) for env in (asked, alone)]
        assert_array_equal(both[0][0], both[1][0])
        assert both[0][1:] == both[1][1:]


@pytest.mark.parametrize("environment_id", ENVIRONMENTS)
@pytest.mark.fast_cases(4)
def test_an_action_is_clipped_before_it_moves_or_costs_anything(environment_id, rng):
    beyond, within = (AssistiveEnv(environment_id, people="revised") for _ in range(2))
    for env in (beyond, within):
        env.reset(seed=3)
    for action in rng.uniform(-50, 50, (5, beyond.action_space.sample().size)):
        both = beyond.step(action), within.step(np.clip(action, -1, 1))
        assert_array_equal(both[0][0], both[1][0])
        assert both[0][1:] == both[1][1:]
        assert both[0][-1]["reward_terms"]["action_squared"] <= 7.0


def test_mujoco_s_warnings_go_to_logging_and_into_no_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    vector = AssistiveVectorEnv(FEEDING, 4, num_threads=2)
    vector.reset(seed=0)
    vector.episodes.simulation.batch.bind("qvel")[:] = np.nan
    vector.episodes.simulation.step()
    assert {record.name for record in caplog.records} == {"avrgym.mujoco"}
    assert "simulation is unstable" in caplog.text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"people": "martians"}, "allowed: original, revised"),
        ({"render_mode": "human"}, "allowed: None, rgb_array; `avrgym view avrgym/FeedingJaco-v1`"),
    ],
)
def test_unknown_names_are_told_what_there_is(how, message):
    for make in (AssistiveEnv, AssistiveVectorEnv, gym.make, gym.make_vec):
        with pytest.raises(ValueError, match=message):
            make(FEEDING, **how)


def test_a_seed_may_be_numpy_s():
    one, other = (AssistiveEnv(FEEDING, people="revised") for _ in range(2))
    assert_array_equal(one.reset(seed=np.int64(3))[0], other.reset(seed=3)[0])


def test_a_person_can_be_fixed():
    person = Person("woman", 0.5)
    env = AssistiveEnv(FEEDING, person=person)
    for seed in range(3):
        env.reset(seed=seed)
        assert env.episodes.get_person(0).torso_height_m == 0.5
        assert env.episodes.get_person(0).sex == "woman"


# Determinism


def rollout(env: gym.Env, actions: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    observations, rewards = [env.reset(seed=seed)[0]], []
    for action in actions:
        observation, reward, *_ = env.step(action)
        observations.append(observation)
        rewards.append(reward)
    return np.stack(observations), np.array(rewards)


def test_a_world_has_the_same_bits_alone_and_among_64(rng):
    """World i of seed s is the single environment of seed s + i."""
    actions = rng.uniform(-1, 1, (10, 64, 7)).astype(np.float32)
    vector = gym.make_vec(FEEDING, num_envs=64, people="revised")
    observations, rewards = [vector.reset(seed=100)[0]], []
    for action in actions:
        observation, reward, *_ = vector.step(action)
        observations.append(observation)
        rewards.append(reward)
    for world in (0, 31, 63):
        alone = gym.make(FEEDING, people="revised")
        single_observations, single_rewards = rollout(alone, actions[:, world], seed=100 + world)
        assert_array_equal(np.stack(observations)[:, world], single_observations)
        assert_array_equal(np.stack(rewards)[:, world], single_rewards)


def test_the_same_seed_makes_the_same_episode(rng):
    actions = rng.uniform(-1, 1, (5, 7)).astype(np.float32)
    one, other = (rollout(gym.make(FEEDING, people="revised"), actions, seed=7) for _ in range(2))
    assert_array_equal(one[0], other[0])
    assert_array_equal(one[1], other[1])
    different = rollout(gym.make(FEEDING, people="revised"), actions, seed=8)
    assert not np.array_equal(one[0], different[0])


def test_without_a_seed_the_episodes_go_on_differently():
    env = gym.make(FEEDING, people="revised")
    first, second = env.reset(seed=7)[0], env.reset()[0]
    assert not np.array_equal(first, second)


# Many worlds


def test_a_finished_world_begins_again_within_the_step():
    vector = gym.make_vec(FEEDING, num_envs=3)
    assert vector.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    vector.reset(seed=0)
    still = np.zeros((3, 7), np.float32)
    for _ in range(EPISODE_STEPS - 1):
        *_, truncated, info = vector.step(still)
        assert not truncated.any()
        assert "final_obs" not in info
    observation, _, terminated, truncated, info = vector.step(still)
    assert truncated.all()
    assert not terminated.any()
    final = np.stack(info["final_obs"])
    assert final.shape == observation.shape
    assert not np.array_equal(final, observation)
    assert set(info["final_info"]) >= {"success", "reward_terms", "force_on_person"}
    assert not vector.step(still)[3].any()


def test_seeds_may_be_given_one_by_one():
    vector = AssistiveVectorEnv(FEEDING, 3, people="revised")
    listed, _ = vector.reset(seed=[5, 6, 7])
    counted, _ = vector.reset(seed=5)
    assert_array_equal(listed, counted)


def test_observations_stay_inside_their_space(rng):
    """Also at full speed into the person, the chair and the table."""
    vector = AssistiveVectorEnv(FEEDING, 32, people="revised")
    observation, _ = vector.reset(seed=0)
    bound = vector.episodes.observation_spec.bound
    assert vector.single_observation_space == gym.spaces.Box(-bound, bound, dtype=np.float64)
    assert np.isfinite(bound).all()
    assert isinstance(observation, np.ndarray)
    largest = np.abs(observation).max(axis=0)
    for signs in np.sign(rng.uniform(-1, 1, (8, 32, 7))).astype(np.float32):
        for _ in range(5):
            observation, *_ = vector.step(signs)
            assert observation in vector.observation_space
            largest = np.maximum(largest, np.abs(observation).max(axis=0))
    assert (largest < 0.9999 * bound).all()


# Pictures


def test_without_a_render_mode_there_is_no_picture():
    env = AssistiveEnv(FEEDING)
    env.reset(seed=0)
    assert env.render() is None


@pytest.mark.slow
@needs_graphics
def test_a_picture_shows_the_scene_as_it_stands():
    env = AssistiveEnv(FEEDING, people="revised", render_mode="rgb_array")
    env.reset(seed=0)
    first, again = env.render(), env.render()
    assert first is not None
    assert first.shape == (480, 640, 3)
    assert first.dtype == np.uint8
    assert_array_equal(first, again)
    env.step(np.ones(7, np.float32))
    moved = env.render()
    assert 0.0005 < (moved != first).any(axis=-1).mean() < 0.2  # the arm, not the room
    env.reset(seed=1)
    assert (env.render() != moved).any(axis=-1).mean() > 0.01  # another person, another bowl
    env.close()


@pytest.mark.slow
@needs_graphics
def test_a_picture_shows_person_robot_and_food():
    """Each is large enough to see, in pixels."""
    env = AssistiveEnv(FEEDING, person=Person("man", 0.6), render_mode="rgb_array")
    env.reset(seed=0)
    env.render()
    pixels = pixels_by_body(env)
    assert pixels["person/face"] > 2000
    assert pixels["person/shirt"] > 5000
    assert pixels["wheelchair"] > 5000
    assert sum(count for body, count in pixels.items() if body.startswith("robot/")) > 5000
    assert pixels["robot/tool"] > 150
    assert pixels["bowl"] > 500
    assert sum(count for body, count in pixels.items() if body.startswith("food")) > 20
    env.close()


def pixels_by_body(env: AssistiveEnv) -> Counter[str]:
    """How much of its picture shows which body or skin."""
    assert env._camera is not None
    env._camera._renderer.enable_segmentation_rendering()
    model = env._camera._model
    shown = np.asarray(env._camera.render(), dtype=int).reshape(-1, 2)
    pixels: Counter[str] = Counter()
    for (number, kind), count in zip(*np.unique(shown, axis=0, return_counts=True), strict=True):
        if kind == mujoco.mjtObj.mjOBJ_GEOM:
            pixels[model.body(model.geom_bodyid[number]).name] += int(count)
        elif kind == mujoco.mjtObj.mjOBJ_SKIN:
            pixels[model.skin(number).name] += int(count)
    return pixels


@pytest.mark.slow
@needs_graphics
def test_many_worlds_have_a_picture_each():
    vector = AssistiveVectorEnv(FEEDING, 2, people="revised", render_mode="rgb_array")
    vector.reset(seed=0)
    pictures = vector.render()
    assert pictures is not None
    assert [picture.shape for picture in pictures] == [(480, 640, 3)] * 2
    assert not np.array_equal(pictures[0], pictures[1])
    alone = AssistiveEnv(FEEDING, people="revised", render_mode="rgb_array")
    alone.reset(seed=1)
    picture = alone.render()
    assert_array_equal(picture, pictures[1])
    vector.close()
    alone.close()


def test_where_nothing_can_be_drawn_the_error_says_what_to_set(monkeypatch):
    monkeypatch.setattr("avrgym.tasks.camera_images.find_rendering_error", lambda: "no library")
    env = AssistiveEnv(FEEDING, render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(2):
        with pytest.raises(RuntimeError, match=r"MUJOCO_GL=egl .* MUJOCO_GL=osmesa .*; no library"):
            env.render()
