"""Laws of environments with a force guard: same bits as evaluation, copies continue, resets are per world."""

import copy
import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.testing import assert_array_equal

import avrgym
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.safety.force_guard import ForceGuard
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.tasks.episodes import Episodes
from helpers.simulation.contact_forces import actions_towards
from helpers.simulation.vector_environments import assert_same_pair

SCRATCHING, FEEDING = "avrgym/ScratchItchJaco-v1", "avrgym/FeedingJaco-v1"
WORLDS, STEPS = 4, 25


def episodes_of(env: gym.vector.VectorEnv) -> Episodes:
    unwrapped = env.unwrapped
    assert isinstance(unwrapped, AssistiveVectorEnv)
    return unwrapped.episodes


def guard_of(episodes: Episodes) -> ForceGuard:
    assert episodes.control_loop.guard is not None
    return episodes.control_loop.guard


def pressing(episodes: Episodes) -> np.ndarray:
    """Actions that move each robot towards a part of its person."""
    return actions_towards(episodes, np.arange(episodes.simulation.num_worlds) % 4).astype(np.float32)


def test_guarded_worlds_get_the_same_bits_in_gymnasium_and_in_evaluation() -> None:
    env = gym.make_vec(SCRATCHING, num_envs=WORLDS, force_guard=True)
    env.reset(seed=0)
    episodes = Episodes(SCRATCHING, WORLDS, force_guard=True)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng(seed) for seed in range(WORLDS)])
    recorder = RegionLoadRecorder(WORLDS)
    interventions = np.zeros(WORLDS, dtype=int)
    for _ in range(STEPS):
        actions = pressing(episodes)
        observation, reward, _, _, info = env.step(actions)
        step = episodes.step(actions.astype(float), recorder)
        assert_array_equal(observation, step.observation)
        assert_array_equal(reward, step.reward)
        assert_array_equal(info["guard_interventions"], step.guard_interventions)
        overridden = info.get("_executed_action", np.zeros(WORLDS, dtype=bool))
        assert_array_equal(overridden, (step.executed_action != actions).any(axis=-1))
        if overridden.any():
            assert_array_equal(info["executed_action"][overridden], step.executed_action[overridden])
        interventions = info["guard_interventions"]
    assert interventions.any()


def test_one_guarded_world_is_a_row_of_many() -> None:
    single, vector = (
        gym.make(SCRATCHING, force_guard=True),
        gym.make_vec(SCRATCHING, num_envs=WORLDS, force_guard=True),
    )
    single.reset(seed=1)
    vector.reset(seed=0)
    episodes = episodes_of(vector)
    for _ in range(STEPS):
        actions = pressing(episodes)
        observation, reward, _, _, info = single.step(actions[1])
        observations, rewards, _, _, infos = vector.step(actions)
        assert_array_equal(observation, observations[1])
        assert reward == rewards[1]
        assert info["guard_interventions"] == infos["guard_interventions"][1]
        assert ("executed_action" in info) == bool(infos.get("_executed_action", np.zeros(WORLDS))[1])


def test_a_guard_that_does_not_intervene_changes_no_bit(rng: np.random.Generator) -> None:
    guarded, plain = (
        gym.make_vec(FEEDING, num_envs=2, people="participants", force_guard=guard) for guard in (True, False)
    )
    assert_array_equal(guarded.reset(seed=3)[0], plain.reset(seed=3)[0])
    for _ in range(8):
        actions = rng.uniform(-0.2, 0.2, (2, 7)).astype(np.float32)
        one, other = guarded.step(actions), plain.step(actions)
        assert not one[4]["guard_interventions"].any()
        assert "executed_action" not in one[4]
        for name in ("guard_interventions", "_guard_interventions"):
            del one[4][name]
        assert_same_pair(one, other, "step")


@pytest.mark.parametrize("how", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_a_copy_continues_to_the_same_bits(how) -> None:
    """Copied while the guard overrides a robot."""
    env = gym.make_vec(SCRATCHING, num_envs=WORLDS, force_guard=True)
    env.reset(seed=0)
    episodes = episodes_of(env)
    while not guard_of(episodes).override_mask.any():
        env.step(pressing(episodes))
    other = how(env)
    for _ in range(12):
        actions = pressing(episodes)
        assert_same_pair(other.step(actions), env.step(actions), "step")


def test_a_reset_clears_the_guard_of_its_worlds_alone() -> None:
    env = gym.make_vec(SCRATCHING, num_envs=WORLDS, force_guard=True, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    episodes = episodes_of(env)
    guard = guard_of(episodes)
    while guard.num_interventions.astype(bool).sum() < 2:
        env.step(pressing(episodes))
    before = guard.num_interventions
    reset, other = np.flatnonzero(before)[:2]
    mask = np.arange(WORLDS) == reset
    _, info = env.reset(options={"reset_mask": mask})
    assert info["guard_interventions"][reset] == 0
    assert guard.num_interventions[reset] == 0
    assert guard.num_interventions[other] == before[other]
    assert not guard.override_mask[reset]
    assert_array_equal(
        guard._path[reset], np.tile(episodes.simulation.get_joint_positions()[reset], (150, 1))
    )


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
@pytest.mark.fast_cases(1)
def test_infos_are_those_of_gymnasiums_own_vector_environment(mode: AutoresetMode) -> None:
    native = gym.make_vec(
        SCRATCHING, num_envs=2, force_guard=True, autoreset_mode=mode, max_episode_steps=STEPS
    )
    sync = SyncVectorEnv(
        [lambda: gym.make(SCRATCHING, force_guard=True, max_episode_steps=STEPS)] * 2, autoreset_mode=mode
    )
    assert_same_pair(native.reset(seed=0), sync.reset(seed=0), "reset")
    episodes = episodes_of(native)
    for number in range(STEPS + 3):
        actions = pressing(episodes)
        assert_same_pair(native.step(actions), sync.step(actions), f"step {number}")


def test_the_environment_checker_passes() -> None:
    check_env(gym.make(FEEDING, force_guard=True).unwrapped, skip_render_check=True)


def test_robot_and_human_have_a_guard_too() -> None:
    env = avrgym.parallel_env(SCRATCHING, force_guard=True)
    _, infos = env.reset(seed=0)
    assert infos["robot"]["guard_interventions"] == 0
    human = np.zeros_like(env.action_space("human").sample())
    for _ in range(60):
        robot = pressing(env.episodes)[0]
        infos = env.step({"robot": robot, "human": human})[4]
        if "executed_action" in infos["robot"]:
            break
    assert infos["robot"]["guard_interventions"] == infos["human"]["guard_interventions"] == 1


def test_worlds_on_a_device_reject_it() -> None:
    with pytest.raises(ValueError, match="force_guard is not possible on a device"):
        Episodes(FEEDING, 1, force_guard=True, engine="warp:cpu", on_device=True)
