"""Robot and human as two agents, for every environment: PettingZoo's own test, and our laws."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from numpy.testing import assert_allclose, assert_array_equal
from pettingzoo.test import parallel_api_test

import avrgym
from avrgym.envs.parallel import HUMAN_AGENT, ROBOT_AGENT, AssistiveParallelEnv
from avrgym.models.human import JOINT_INDEX, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD
from avrgym.people.zoo.partner_behaviour import MAX_JOINT_SPEED_RAD_S
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import ENVIRONMENTS, TASKS

FEEDING, SCRATCHING = "avrgym/FeedingJaco-v1", "avrgym/ScratchItchJaco-v1"


def actions(env: AssistiveParallelEnv, rng: np.random.Generator, share: float = 1.0) -> dict[str, np.ndarray]:
    """Random actions of the robot, and so large a share of random ones of the human."""
    sizes = {agent: env.action_space(agent).shape for agent in env.possible_agents}
    scale = {ROBOT_AGENT: 1.0, HUMAN_AGENT: share}
    return {agent: scale[agent] * rng.uniform(-1.0, 1.0, size) for agent, size in sizes.items()}


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_every_environment_passes_the_test_of_pettingzoo(environment):
    parallel_api_test(avrgym.parallel_env(environment), num_cycles=12)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(4)
def test_observations_lie_within_their_spaces_and_the_same_seed_gives_the_same_bits(environment, rng):
    first, again = (avrgym.parallel_env(environment, people="revised") for _ in range(2))
    seen, _ = first.reset(seed=3)
    same, _ = again.reset(seed=3)
    for _ in range(6):
        for agent in first.agents:
            assert first.observation_space(agent).contains(seen[agent]), agent
            assert_array_equal(seen[agent], same[agent])
        acted = actions(first, rng)
        (seen, rewards, *_), (same, others, *_) = first.step(acted), again.step(acted)
        assert rewards == others
        assert rewards[ROBOT_AGENT] == rewards[HUMAN_AGENT]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_human_who_does_nothing_is_the_static_person(environment, rng):
    """The same start, and the same episode as long as nothing touches: a static person does not give way in joints."""
    both, alone = avrgym.parallel_env(environment, people="revised"), gym.make(environment, people="revised")
    accuracy = (
        2e-4 if "Drinking" in environment else 1e-9
    )  # what holds 64 particles of water apart is iterated
    for seed in range(3):
        seen, _ = both.reset(seed=seed)
        expected, _ = alone.reset(seed=seed)
        assert_allclose(seen[ROBOT_AGENT], expected, atol=1e-6)
        for _ in range(8):
            acted = actions(both, rng, share=0.0)
            seen, rewards, _, _, infos = both.step(acted)
            expected, reward, *_, info = alone.step(acted[ROBOT_AGENT])
            if max(infos[ROBOT_AGENT]["force_on_person"], info["force_on_person"]) > 0.0:
                break
            assert_allclose(seen[ROBOT_AGENT], expected, atol=accuracy)
            assert rewards[ROBOT_AGENT] == pytest.approx(reward, abs=10.0 * accuracy)


@pytest.mark.parametrize("environment", [FEEDING, SCRATCHING])
def test_the_action_drives_the_joints_that_the_task_offers_and_no_others(environment):
    env = avrgym.parallel_env(environment)
    env.reset(seed=1)
    angles = env.episodes.simulation.get_person_joint_angles_rad
    begin, still = angles()[0], np.zeros(7, np.float32)
    offered = [JOINT_INDEX[name] for name in env.human_joints]
    push = np.ones(len(offered), np.float32)
    for share in (5.0, 0.0, 0.0, 0.0, 0.0):
        env.step({ROBOT_AGENT: still, HUMAN_AGENT: share * push})
    moved = angles()[0] - begin
    wanted = np.clip(begin + 0.1 * MAX_JOINT_SPEED_RAD_S, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD) - begin
    assert_allclose(moved[offered], wanted[offered], atol=0.002)
    others = np.setdiff1d(np.arange(20), offered)
    assert_allclose(moved[others], 0.0, atol=0.002)


@pytest.mark.parametrize(("environment", "arm"), [(SCRATCHING, "right"), ("avrgym/DressingJaco-v1", "left")])
def test_people_observe_the_arm_that_they_offer(environment, arm):
    env = avrgym.parallel_env(environment)
    seen, _ = env.reset(seed=1)
    arm_w = getattr(env.episodes.simulation.get_arm_poses(), f"{arm}_arm_pos_w")[0]
    from_hips = np.linalg.norm(arm_w - env.episodes.simulation.get_hips_pose()[0], axis=-1)
    assert_allclose(np.linalg.norm(seen[HUMAN_AGENT][-11:-2].reshape(3, 3), axis=-1), from_hips, rtol=1e-5)


def test_no_action_drives_a_joint_where_it_cannot_go():
    env = avrgym.parallel_env(FEEDING, impairment="limits")
    env.reset(seed=1)
    for _ in range(60):
        env.step({ROBOT_AGENT: np.zeros(7, np.float32), HUMAN_AGENT: np.ones(6, np.float32)})
    share = env.episodes.people.range_share[0]
    assert (env.episodes.simulation.get_person_joint_angles_rad()[0] <= share * UPPER_LIMITS_RAD + 0.03).all()


def test_each_may_pay_for_its_own_effort():
    shared, own = (avrgym.parallel_env(FEEDING, shared_reward=each) for each in (True, False))
    acted = {
        ROBOT_AGENT: np.full(7, 0.5, np.float32),
        HUMAN_AGENT: np.array([2.0, 0, 0, 0, 0, 0.5], np.float32),
    }
    given = []
    for env in (shared, own):
        env.reset(seed=2)
        given.append(env.step(acted)[1])
    assert given[0][ROBOT_AGENT] == given[0][HUMAN_AGENT] == given[1][ROBOT_AGENT]
    assert given[1][HUMAN_AGENT] - given[1][ROBOT_AGENT] == pytest.approx(-0.01 * (1.25 - 1.75))


def test_an_episode_ends_for_both_and_the_next_is_another():
    env = avrgym.parallel_env(SCRATCHING)
    observation = env.reset(seed=4)[0][HUMAN_AGENT]
    still = {agent: np.zeros(7, np.float32) for agent in env.agents}
    for left in range(EPISODE_STEPS - 1, -1, -1):
        _, _, terminated, truncated, infos = env.step(still)
        assert set(terminated.values()) == {False}
        assert set(truncated.values()) == {left == 0}
        assert infos[ROBOT_AGENT].keys() == {"success", "reward_terms", "force_on_person"}
    assert env.agents == []
    with pytest.raises(ResetNeeded, match="no episode is running"):
        env.step(still)
    assert not np.array_equal(env.reset()[0][HUMAN_AGENT], observation)
    assert_array_equal(env.reset(seed=4)[0][HUMAN_AGENT], observation)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({HUMAN_AGENT: np.full(6, np.nan)}, "human: .* is nan; allowed: finite numbers of shape"),
        ({ROBOT_AGENT: np.full(7, np.inf)}, "robot: .* is inf"),
        (
            {HUMAN_AGENT: np.zeros(7)},
            r"human: actions have the shape \(7,\); allowed: finite numbers of shape \(6,\)",
        ),
        ({HUMAN_AGENT: "up"}, "human: actions are of type str"),
        (
            {"nurse": np.zeros(7)},
            "received actions for robot, human, nurse; allowed: one action for each agent: robot, human",
        ),
    ],
)
def test_actions_that_cannot_be_are_refused_and_nothing_has_moved(changes, said):
    env = avrgym.parallel_env(FEEDING)
    with pytest.raises(ResetNeeded):
        env.step({})
    env.reset(seed=0)
    before = env.episodes.simulation.get_integration_state()
    with pytest.raises(ValueError, match=said):
        env.step({ROBOT_AGENT: np.zeros(7), HUMAN_AGENT: np.zeros(6)} | changes)
    with pytest.raises(ValueError, match="received actions for no agent"):
        env.step({})
    assert_array_equal(env.episodes.simulation.get_integration_state(), before)


def test_a_task_that_wants_nothing_of_people_leaves_the_human_nothing_to_do(monkeypatch):
    monkeypatch.setitem(TASKS, "Feeding", replace(TASKS["Feeding"], offered_body_part="nothing"))
    env = avrgym.parallel_env(FEEDING, people="zoo/train", impairment="tremor")
    assert env.action_space(HUMAN_AGENT).shape == (0,)
    parallel_api_test(env, num_cycles=5)


def test_mistakes_are_named():
    with pytest.raises(ValueError, match=FEEDING):
        avrgym.parallel_env("avrgym/Nope-v1")
    with pytest.raises(ValueError, match="zoo/train"):
        avrgym.parallel_env(FEEDING, people="martians")
    with pytest.raises(ValueError, match="unknown render mode 'human'"):
        avrgym.parallel_env(FEEDING, render_mode="human")
