"""The vector environment has the semantics of Gymnasium's vector environments."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers.vector import RecordEpisodeStatistics
from numpy.testing import assert_array_equal

from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.vector_environments import (
    assert_same,
    assert_same_pair,
    compare,
    invalid_actions,
    make_both,
)

FEEDING = "avrgym/FeedingJaco-v1"
STILL = np.zeros((3, 7), np.float32)


MODES = list(AutoresetMode)
IN_TURN = [(environment, MODES[i % len(MODES)]) for i, environment in enumerate(ENVIRONMENTS)]


@pytest.mark.slow
@pytest.mark.parametrize(("environment", "mode"), [*IN_TURN, (FEEDING, MODES[1]), (FEEDING, MODES[2])])
def test_it_gives_what_gymnasium_s_own_gives(environment, mode, rng):
    """Observations, rewards, ends and infos, over episodes that end at different times."""
    assert compare(environment, mode, 30, rng) >= 4


def test_it_gives_what_gymnasium_s_own_gives_with_people_who_move(rng):
    assert compare(FEEDING, AutoresetMode.SAME_STEP, 15, rng, people="participants") >= 1


def test_the_mode_of_an_instance_stands_in_its_metadata():
    assert gym.make_vec(FEEDING).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    for mode in AutoresetMode:
        for said in (mode, mode.value):
            env = gym.make_vec(FEEDING, num_envs=2, autoreset_mode=said)
            assert env.metadata["autoreset_mode"] is mode
    assert gym.make_vec(FEEDING).metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


@pytest.mark.parametrize("vectorization", ["sync", "async", "vector_entry_point"])
def test_every_vectorisation_of_gymnasium_works(vectorization):
    env = gym.make_vec(FEEDING, num_envs=2, vectorization_mode=vectorization, max_episode_steps=2)
    first, info = env.reset(seed=3)
    assert info["success"].dtype == bool
    for ended in (False, True):
        observation, _, _, truncated, info = env.step(np.ones((2, 7), np.float32))
        assert_array_equal(truncated, ended)
        assert observation.shape == first.shape
    env.close()


# As RLlib does


@pytest.mark.slow
def test_who_expects_episodes_to_begin_in_the_next_step_gets_whole_ones():
    """A learner that drops the step after an end counts episodes of 200 steps that never jump."""
    env = gym.make_vec(FEEDING, num_envs=3, people="revised", autoreset_mode=AutoresetMode.NEXT_STEP)
    observation, _ = env.reset(seed=0)
    lengths, length, farthest_m = [], np.zeros(3, dtype=int), 0.0
    ended = np.zeros(3, dtype=bool)
    for _ in range(402):
        actions = np.where(ended[:, None], np.nan, STILL)  # what is ignored may be anything
        after, reward, terminated, truncated, info = env.step(actions)
        assert_array_equal(reward[ended], 0.0)
        assert_array_equal(info["reward_terms"]["action_squared"][ended], 0.0)
        assert not (truncated & ended).any()
        assert not terminated.any()
        goes_on = ~ended
        farthest_m = max(farthest_m, np.abs((after - observation)[goes_on, :3]).max(initial=0.0))
        length = np.where(goes_on, length + 1, 0)
        lengths += length[truncated].tolist()
        observation, ended = after, truncated
    assert lengths == [200] * 6
    assert farthest_m < 0.02, "the tool of an arm at rest never jumps"


def test_gymnasium_s_statistics_of_episodes_hold_in_every_mode():
    for mode in AutoresetMode:
        env = RecordEpisodeStatistics(
            gym.make_vec(FEEDING, num_envs=3, max_episode_steps=5, autoreset_mode=mode)
        )
        env.reset(seed=0)
        rewards = [env.step(STILL) for _ in range(5)]
        info = rewards[-1][-1]
        told = info["final_info"] if "episode" not in info else info
        assert_array_equal(told["episode"]["l"], 5)
        assert told["episode"]["r"] == pytest.approx(sum(step[1] for step in rewards))


# Resets


def test_a_world_that_has_ended_has_to_be_begun_where_nothing_begins_by_itself():
    env = AssistiveVectorEnv(FEEDING, 3, max_episode_steps=2, autoreset_mode="Disabled", num_threads=1)
    env.reset(seed=0)
    env.step(STILL)
    env.reset(options={"reset_mask": np.array([False, True, False])})
    *_, truncated, _ = env.step(STILL)
    assert_array_equal(truncated, [True, False, True])
    before = env.episodes.simulation.batch.state.copy()
    with pytest.raises(ResetNeeded, match=r"worlds \[0, 2\] have ended"):
        env.step(STILL)
    assert_array_equal(env.episodes.simulation.batch.state, before)
    mask = np.array([True, False, True])
    options = {"reset_mask": mask}
    env.reset(options=options)
    assert options["reset_mask"] is mask
    assert_array_equal(env.step(STILL)[3], [False, True, False])


@pytest.mark.parametrize(
    "mask", [[True, False], np.ones(3), np.zeros(3, dtype=bool), np.ones((3, 1), dtype=bool), True, "all"]
)
def test_a_mask_of_another_kind_is_refused(mask):
    env = AssistiveVectorEnv(FEEDING, 3, num_threads=1)
    first, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"allowed: a boolean array of shape \(3,\)"):
        env.reset(seed=9, options={"reset_mask": mask})
    assert_array_equal(env.reset(seed=0)[0], first)


def test_the_first_reset_is_for_all_worlds():
    env = AssistiveVectorEnv(FEEDING, 3, num_threads=1)
    with pytest.raises(ResetNeeded, match=r"call reset\(\) first"):
        env.step(STILL)
    with pytest.raises(ResetNeeded, match="the first reset does not include all worlds"):
        env.reset(options={"reset_mask": np.array([True, False, True])})


@pytest.mark.parametrize(
    "seed", [np.int64(5), np.array([5, 6, 7]), [np.uint32(5), 6, np.int8(7)], (5, 6, 7)], ids=repr
)
def test_seeds_may_be_numpy_s(seed):
    env = AssistiveVectorEnv(FEEDING, 3, people="revised", num_threads=1)
    assert_array_equal(env.reset(seed=seed)[0], env.reset(seed=5)[0])
    assert env.np_random_seed == (5, 6, 7)


def test_seeds_that_do_not_fit_are_refused():
    env = AssistiveVectorEnv(FEEDING, 3, num_threads=1)
    first, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match="2 seeds; allowed: one number, or a list of 3"):
        env.reset(seed=[1, 2])
    with pytest.raises(gym.error.Error, match="greater or equal to zero"):
        env.reset(seed=[1, 2, -1])
    assert env.np_random_seed == (0, 1, 2)
    assert_array_equal(env.reset(seed=0)[0], first)


def test_what_was_given_may_be_changed():
    """Nothing that comes later depends on arrays that were given."""
    changed, kept = (AssistiveVectorEnv(FEEDING, 3, num_threads=1) for _ in range(2))
    for env in (changed, kept):
        observation, _ = env.reset(seed=0)
        assert isinstance(observation, np.ndarray)
        if env is changed:
            observation[:] = 9.0
        given = env.step(STILL)
        if env is changed:
            for array in (*given[:4], given[4]["success"], given[4]["reward_terms"]["distance_m"]):
                np.asarray(array)[:] = 1
    mask = np.array([False, True, False])
    first, second = (env.reset(options={"reset_mask": mask})[0] for env in (changed, kept))
    assert isinstance(first, np.ndarray)
    assert isinstance(second, np.ndarray)
    assert_same(first[~mask], second[~mask], "the worlds that go on")


# Arguments and attributes


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ({"num_envs": 0}, "num_envs is 0; allowed: an integer of 1 or more"),
        ({"num_envs": 2.0}, "num_envs is 2.0; allowed: an integer of 1 or more"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0; allowed: an integer of 1 or more"),
        ({"max_episode_steps": 1.5}, "max_episode_steps is 1.5; allowed: an integer of 1 or more"),
        ({"autoreset_mode": "never"}, "unknown autoreset mode 'never'; allowed: .*NEXT_STEP or 'NextStep'"),
        ({"render_mode": "human"}, "`avrgym view avrgym/FeedingJaco-v1` shows the environment live"),
    ],
)
def test_arguments_are_told_what_is_allowed(how, message):
    with pytest.raises(ValueError, match=message):
        gym.make_vec(FEEDING, **how)


def test_an_unknown_keyword_is_named():
    for make in (gym.make, gym.make_vec):
        with pytest.raises(ValueError, match="unknown setting peeple"):
            make(FEEDING, peeple="original")


def test_attributes_are_those_of_gymnasium_s_own():
    ours, theirs = make_both(FEEDING, AutoresetMode.SAME_STEP, "original")
    assert isinstance(theirs, SyncVectorEnv)
    assert isinstance(ours, AssistiveVectorEnv)
    for env in (ours, theirs):
        env.reset(seed=4)
    for name in ("observation_space", "action_space", "metadata", "render_mode", "np_random_seed"):
        assert ours.get_attr(name) == theirs.get_attr(name), name
        assert ours.call(name) == theirs.call(name), name
    assert ours.call("render") == theirs.call("render") == (None, None, None)
    for one, other in zip(ours.get_attr("np_random"), theirs.get_attr("np_random"), strict=True):
        assert one.bit_generator.state == other.bit_generator.state
    for values in ([1, 2, 3], (4, 5, 6), "all"):
        for env in (ours, theirs):
            env.set_attr("weight", values)
        assert ours.get_attr("weight") == theirs.get_attr("weight")
    for env in (ours, theirs):
        with pytest.raises(ValueError, match=r"\b2\W* values"):
            env.set_attr("weight", [1, 2])
        with pytest.raises(AttributeError, match="nonsense"):
            env.get_attr("nonsense")
    assert_same_pair(ours.step(STILL), theirs.step(STILL), "a step")


# Actions


@pytest.mark.parametrize("mode", AutoresetMode)
def test_an_action_that_is_none_is_refused_before_anything_moves(mode, rng):
    """The step after it is the one that would have been, had nobody asked."""
    asked, alone = (
        AssistiveVectorEnv(FEEDING, 3, people="participants", num_threads=1, autoreset_mode=mode)
        for _ in range(2)
    )
    for env in (asked, alone):
        env.reset(seed=1)
    for action in invalid_actions((3, 7)):
        with pytest.raises(ValueError, match=r"allowed: finite numbers of shape \(3, 7\), -1 to 1"):
            asked.step(action)
    for actions in rng.uniform(-1, 1, (3, 3, 7)):
        assert_same_pair(asked.step(actions), alone.step(actions), "a step")
