"""Training of robot and human together, and trained humans as people."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner, Result

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

import avrgym
from avrgym.cli.main import app
from avrgym.envs.parallel import HUMAN_AGENT, ROBOT_AGENT
from avrgym.learning import training
from avrgym.learning.configuration import FeedforwardConfiguration, JointTrainingSettings
from avrgym.learning.evaluation import evaluate
from avrgym.learning.rollouts import RolloutRequest, WorldSettings, roll_out_agents
from avrgym.learning.training import TrainingProgress, resume_training, train
from avrgym.networks.policy import Policy, PolicyError, TrainedHumanMetadata
from avrgym.people.populations import find_populations
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.human_observation import make_human_observer
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, get_observation_and_action_size
from helpers.learning.random_networks import random_network, save_network

pytestmark = pytest.mark.usefixtures("one_thread")

SCRATCHING, FEEDING = "avrgym/ScratchItchJaco-v1", "avrgym/FeedingJaco-v1"
OFFERING = [name for name, (task, _) in ENVIRONMENTS.items() if TASKS[task].offered_body_part != "nothing"]
"""Environments in which people have actions."""
OF_EACH_TASK = list({ENVIRONMENTS[name][0]: name for name in OFFERING}.values())
WORLDS = 2
UPDATE = WORLDS * EPISODE_STEPS
PAIR = FeedforwardConfiguration(
    environment=SCRATCHING,
    people="zoo/train",
    impairment="weakness",
    steps=2 * UPDATE,
    seed=4,
    num_envs=WORLDS,
    batch_size=200,
    n_epochs=1,
    threads=1,
    imitation_rounds=0,
    pairing=JointTrainingSettings(),
)
LONG = replace(
    PAIR,
    steps=5 * UPDATE,
    imitation_rounds=1,
    critic_updates=0,
    hard_share=0.5,
    pairing=JointTrainingSettings(alternate=1),
)


@pytest.fixture(autouse=True)
def _measured_shortly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)


# The training


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """The folder of a pair after two updates."""
    out = tmp_path_factory.mktemp("runs") / "pair"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "EVALUATION_EPISODES", 1)
        train(PAIR, out)
    return out


def assert_same_weights(first: Path, second: Path) -> None:
    one, other = (torch.load(out / "checkpoint.pt", weights_only=True) for out in (first, second))
    assert one["steps"] == other["steps"] == one["human"]["steps"]
    for agent, same in ((one, other), (one["human"], other["human"])):
        for part in ("policy", "observations", "returns"):
            for name, value in agent[part].items():
                assert_array_equal(np.asarray(value), np.asarray(same[part][name]), err_msg=name)
    for name in ("policy.safetensors", "human.safetensors"):
        assert Policy.load(first / name).parameters_sha256 == Policy.load(second / name).parameters_sha256


@pytest.mark.slow
def test_a_pair_writes_two_networks_with_matching_metadata(trained):
    robot, human = (Policy.load(trained / f"{name}.safetensors") for name in ("policy", "human"))
    view, joints = make_human_observer(SCRATCHING)
    assert (human.observation_size, human.action_size) == (view.size, joints)
    assert (robot.observation_size, robot.action_size) == get_observation_and_action_size(SCRATCHING)
    assert robot.metadata.human is None
    assert robot.metadata.people == "zoo/train, trained together"
    assert human.metadata.human == TrainedHumanMetadata(partner=robot.parameters_sha256)
    for metadata in (robot.metadata, human.metadata):
        assert (metadata.environment, metadata.impairment) == (SCRATCHING, "weakness")
        assert (metadata.seed, metadata.steps) == (4, 2 * UPDATE)
        assert metadata.measured["episodes"] == 1
    assert human.metadata.people == "zoo/train"


@pytest.mark.slow
def test_the_seed_determines_both_networks_of_a_pair(trained, tmp_path):
    train(PAIR, tmp_path / "again")
    assert_same_weights(trained, tmp_path / "again")
    train(replace(PAIR, seed=5), tmp_path / "other")
    for name in ("policy.safetensors", "human.safetensors"):
        assert (
            Policy.load(trained / name).parameters_sha256
            != Policy.load(tmp_path / "other" / name).parameters_sha256
        )


@pytest.mark.slow
def test_an_interrupted_pair_resumes_to_the_same_weights(tmp_path):
    """After imitation, while one agent learns, and after two interruptions."""

    def killed(after: int) -> Callable[[TrainingProgress], None]:
        def kill(progress: TrainingProgress) -> None:
            if progress.num_timesteps == after * UPDATE:
                raise KeyboardInterrupt

        return kill

    train(LONG, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(LONG, tmp_path / "cut", killed(1))
    for after in (3, 4):
        with pytest.raises(KeyboardInterrupt):
            resume_training(tmp_path / "cut", killed(after))
    resume_training(tmp_path / "cut")
    assert_same_weights(tmp_path / "whole", tmp_path / "cut")


@pytest.mark.slow
def test_alternating_agents_learn_one_at_a_time(tmp_path):
    """First the robot, then the human; only log_std follows the steps for both."""

    def agents() -> list[dict[str, np.ndarray]]:
        state = torch.load(tmp_path / "checkpoint.pt", weights_only=True)
        return [
            {name: np.asarray(value) for name, value in each["policy"].items() if name != "log_std"}
            for each in (state, state["human"])
        ]

    def changed(before: dict[str, np.ndarray], after: dict[str, np.ndarray]) -> bool:
        return any(not np.array_equal(before[name], after[name]) for name in before)

    train(replace(PAIR, critic_updates=0, pairing=JointTrainingSettings(alternate=1), steps=UPDATE), tmp_path)
    first = agents()
    resume_training(tmp_path, steps=2 * UPDATE)
    second = agents()
    resume_training(tmp_path, steps=3 * UPDATE)
    third = agents()
    assert [changed(*each) for each in zip(first, second, strict=True)] == [False, True]
    assert [changed(*each) for each in zip(second, third, strict=True)] == [True, False]


@pytest.mark.parametrize("alternate", [0, 1, 3])
def test_agents_alternate_after_equal_numbers_of_updates(alternate):
    how = replace(LONG, steps=100 * UPDATE, pairing=JointTrainingSettings(alternate=alternate))
    turns = [how.find_learning_agents(how.imitation_steps + number * UPDATE) for number in range(12)]
    one = [(True, False)] * alternate + [(False, True)] * alternate
    assert turns == (one * 12)[:12] if alternate else [(True, True)] * 12
    assert replace(how, pairing=None).find_learning_agents(0) == (True, True)


# The episodes


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", OFFERING)
def test_rollouts_of_a_pair_equal_the_parallel_environment(environment):
    """With the same actions of both; observations and rewards of both, and those of each agent's own effort."""
    networks = [random_network(environment, of_human=of_human, deviation=0.3) for of_human in (False, True)]
    place = WorldSettings(
        environment, TransferredFile.read("zoo/train"), "tremor", 1, "threads", episode_steps=6
    )
    request = RolloutRequest(place, 0, np.array([7, 8]), noise_seed=(1, 2), shared_reward=False)
    robot, human = roll_out_agents(networks, request)
    for world, seed in enumerate(request.episode_seeds):
        env = avrgym.parallel_env(environment, people="zoo/train", impairment="tremor", shared_reward=False)
        seen, _ = env.reset(seed=int(seed))
        for number in range(6):
            for agent, made in ((ROBOT_AGENT, robot), (HUMAN_AGENT, human)):
                assert_array_equal(seen[agent].astype(np.float32), made.observations[number, world])
            actions = {
                agent: np.clip(made.actions[number, world], -1, 1)
                for agent, made in ((ROBOT_AGENT, robot), (HUMAN_AGENT, human))
            }
            seen, rewards, *_ = env.step(actions)
            for agent, made in ((ROBOT_AGENT, robot), (HUMAN_AGENT, human)):
                assert np.float32(rewards[agent]) == made.rewards[number, world]
        assert_array_equal(seen[HUMAN_AGENT].astype(np.float32), human.observations[-1, world])
        assert len(np.unique(robot.actions)) > 1


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("environment", OFFERING)
def test_a_trained_human_acts_as_in_the_parallel_environment(environment, tmp_path, monkeypatch):
    """The same start, the actions that the network says there, and the same worlds after them."""
    human = random_network(environment, people="zoo/train", impairment="tremor", deviation=0.0)
    worlds = Episodes(
        environment, 2, people=save_network(tmp_path / "human.safetensors", human), num_threads=1
    )
    envs = [avrgym.parallel_env(environment, people="zoo/train", impairment="tremor") for _ in range(2)]
    commanded: list[np.ndarray] = []
    steer = worlds.command_people
    monkeypatch.setattr(worlds, "command_people", lambda action: (commanded.append(action), steer(action)))
    worlds.reset(np.arange(2), [np.random.default_rng(seed) for seed in (3, 4)])
    seen = [env.reset(seed=seed)[0] for env, seed in zip(envs, (3, 4), strict=True)]
    robot = np.full(worlds.action_size, 0.3)
    for _ in range(8):
        worlds.step(np.stack([robot, robot]))
        for world, env in enumerate(envs):
            action = np.clip(human.compute_mean_actions(seen[world][HUMAN_AGENT][None])[0], -1, 1).astype(
                np.float32
            )
            assert_array_equal(commanded[-1][world], action.astype(float))
            seen[world] = env.step({ROBOT_AGENT: robot, HUMAN_AGENT: action})[0]
            both = (
                worlds.simulation.get_integration_state(world),
                env.episodes.simulation.get_integration_state(),
            )
            assert_array_equal(*both)
    assert np.abs(commanded).max() > 0.0


def test_a_human_s_noise_follows_from_the_world_s_stream(tmp_path):
    path = save_network(tmp_path / "human.safetensors", random_network(SCRATCHING, deviation=0.5))

    def states(seeds: list[int]) -> list[np.ndarray]:
        worlds = Episodes(SCRATCHING, len(seeds), people=path, num_threads=1)
        worlds.reset(np.arange(len(seeds)), [np.random.default_rng(seed) for seed in seeds])
        for _ in range(5):
            worlds.step(np.zeros((len(seeds), worlds.action_size)))
        return [worlds.simulation.get_integration_state(world) for world in range(len(seeds))]

    two, turned, calm = states([1, 2]), states([2, 1, 1]), tmp_path / "calm.safetensors"
    for one, other in ((two[0], turned[1]), (two[1], turned[0]), (two[0], turned[2])):
        assert_array_equal(one, other)
    path = save_network(calm, random_network(SCRATCHING, deviation=0.0))
    assert not np.array_equal(states([1, 2])[0], two[0])


def test_a_copy_of_worlds_with_trained_humans_continues_equally(tmp_path):
    import copy

    for seed in range(3):
        save_network(tmp_path / f"{seed}.safetensors", random_network(SCRATCHING, seed=seed, deviation=0.5))
    worlds = Episodes(SCRATCHING, 3, people=str(tmp_path), num_threads=1)
    worlds.reset(np.arange(3), [np.random.default_rng(seed) for seed in range(3)])
    action = np.full((3, worlds.action_size), 0.2)
    worlds.step(action)
    twin = copy.deepcopy(worlds)
    for _ in range(4):
        assert_array_equal(worlds.step(action).observation, twin.step(action).observation)
    assert_array_equal(worlds.observe_humans(), twin.observe_humans())


# Populations


def test_each_world_has_one_human_of_a_population_with_its_own_body(tmp_path):
    """Still people of the same height, others who tremble, and robots' policies that lie beside are passed over."""
    save_network(tmp_path / "a" / "human.safetensors", random_network(SCRATCHING, people="original"))
    save_network(
        tmp_path / "b" / "human.safetensors",
        random_network(SCRATCHING, people="revised", impairment="tremor"),
    )
    for place in ("a/policy.safetensors", "robot.safetensors"):
        save_network(tmp_path / place, random_network(SCRATCHING, of_human=False))
    kinds = find_populations(str(tmp_path), TASKS)
    assert [Path(kind.name).parent.name for kind in kinds] == ["a", "b"]
    together = Episodes(SCRATCHING, 12, people=str(tmp_path), num_threads=1)
    together.reset(np.arange(12), [np.random.default_rng(seed) for seed in range(12)])
    alone = Episodes(SCRATCHING, 1, people=str(tmp_path), num_threads=1)
    trembling = together.people.tremor_rad.any(axis=1)
    heights = together.people.torso_height_m
    assert 0 < trembling.sum() < 12
    assert np.isin(heights[~trembling].round(2), (0.54, 0.60)).all()
    for _ in range(3):
        together.step(np.zeros((12, together.action_size)))
    for seed in (0, 5):
        alone.reset(np.array([0]), [np.random.default_rng(seed)])
        for _ in range(3):
            alone.step(np.zeros((1, alone.action_size)))
        assert_array_equal(
            alone.simulation.get_integration_state(), together.simulation.get_integration_state(seed)
        )


def test_a_given_impairment_replaces_that_of_the_human(tmp_path):
    path = save_network(tmp_path / "human.safetensors", random_network(SCRATCHING, impairment="weakness"))

    def people(impairment: str):
        worlds = Episodes(SCRATCHING, 4, people=path, impairment=impairment, num_threads=1)
        worlds.reset(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
        return worlds.people

    own, tremor = people("none"), people("tremor")
    assert (own.strength_share < 1.0).all()
    assert not own.tremor_rad.any()
    assert (tremor.strength_share == 1.0).all()
    assert tremor.tremor_rad.any()


def test_people_are_transferred_with_their_files(tmp_path, monkeypatch):
    from avrgym.people.populations import read_people_for_workers

    save_network(tmp_path / "here" / "a" / "human.safetensors", random_network(SCRATCHING))
    save_network(tmp_path / "here" / "b.safetensors", random_network(SCRATCHING, seed=1))
    found = [each.trained_policy for each in find_populations(str(tmp_path / "here"), TASKS)]
    carried = read_people_for_workers(str(tmp_path / "here"))
    assert carried.get_local_path() == str(tmp_path / "here")
    shutil.move(tmp_path / "here", tmp_path / "away")
    again = [each.trained_policy for each in find_populations(carried.get_local_path(), TASKS)]
    assert [each.parameters_sha256 for each in again if each] == [
        each.parameters_sha256 for each in found if each
    ]
    assert len(again) == 2


# Where people are named


@pytest.mark.slow
def test_a_training_with_trained_humans_resumes_without_their_files(tmp_path):
    for seed in range(2):
        save_network(tmp_path / "humans" / f"{seed}.safetensors", random_network(SCRATCHING, seed=seed))
    alone = replace(PAIR, people=str(tmp_path / "humans"), impairment="none", pairing=None)

    def kill(progress: TrainingProgress) -> None:
        raise KeyboardInterrupt

    whole = train(alone, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(alone, tmp_path / "cut", kill)
    shutil.rmtree(tmp_path / "humans")
    resumed = resume_training(tmp_path / "cut")
    assert resumed.metadata.people == whole.metadata.people == "trained: humans"
    assert len(find_populations(str(tmp_path / "cut" / "people"), TASKS)) == 2
    assert resumed.parameters_sha256 == whole.parameters_sha256
    assert resumed.metadata.measured == whole.metadata.measured


@pytest.mark.slow
def test_a_trained_human_contains_its_file_of_people(tmp_path):
    text = "cooperating = false\n[torso_height_m]\nman = [0.51, 0.52]\nwoman = [0.51, 0.52]\n"
    (tmp_path / "people.toml").write_text(text)
    train(replace(PAIR, people=str(tmp_path / "people.toml"), steps=UPDATE), tmp_path / "pair")
    human = Policy.load(tmp_path / "pair" / "human.safetensors")
    assert human.metadata.people == "fitted: people.toml"
    shutil.move(tmp_path / "pair" / "human.safetensors", tmp_path / "human.safetensors")
    shutil.rmtree(tmp_path / "pair")
    (tmp_path / "people.toml").unlink()
    worlds = Episodes(SCRATCHING, 3, people=str(tmp_path / "human.safetensors"), num_threads=1)
    worlds.reset(np.arange(3), [np.random.default_rng(seed) for seed in range(3)])
    assert ((worlds.people.torso_height_m >= 0.51) & (worlds.people.torso_height_m <= 0.52)).all()


@pytest.mark.slow
@pytest.mark.parametrize("environment", OF_EACH_TASK)
def test_a_pair_is_trained_and_evaluated_in_each_task(environment, tmp_path):
    few = replace(PAIR, environment=environment, num_envs=1, steps=EPISODE_STEPS, people="revised")
    policy = train(few, tmp_path)
    human = str(tmp_path / "human.safetensors")
    found = evaluate(environment, str(tmp_path / "policy.safetensors"), human, 1, 0, split="validation")
    assert policy.metadata.measured["reward_mean"] == found.reward_mean
    assert Policy.load(human).metadata.measured == policy.metadata.measured


# Refusals


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(each) for each in arguments])


def assert_refused(result: Result, said: str) -> None:
    """In one line."""
    assert result.exit_code == 1
    assert said in result.stderr.replace("\n", " "), result.output
    assert len(result.stderr.splitlines()) == 1


def test_unsuitable_people_are_refused_in_one_line(tmp_path):
    human = save_network(tmp_path / "human.safetensors", random_network(SCRATCHING))
    robot = save_network(tmp_path / "robot.safetensors", random_network(SCRATCHING, of_human=False))
    damaged = tmp_path / "damaged.safetensors"
    damaged.write_bytes(Path(human).read_bytes()[:-40])
    resized = replace(random_network(FEEDING), metadata=random_network(SCRATCHING).metadata)
    resized_path = save_network(tmp_path / "resized.safetensors", resized)
    (tmp_path / "empty").mkdir()
    evaluation = "evaluate", SCRATCHING, "--episodes", 1, "--people"
    assert_refused(
        run("evaluate", FEEDING, "--people", human),
        f"this human was trained for {SCRATCHING}; for {FEEDING}, train one",
    )
    assert_refused(
        run(*evaluation, robot),
        "is the policy of a robot; allowed: policies of trained humans. Use this file with --policy",
    )
    assert_refused(
        run("evaluate", SCRATCHING, "--policy", human), "is the policy of a trained human, not of a robot"
    )
    assert_refused(run(*evaluation, damaged), "not a readable .safetensors file")
    assert_refused(run(*evaluation, resized_path), "allowed in avrgym/ScratchItchJaco-v1: 41 and 7")
    assert_refused(run(*evaluation, tmp_path / "empty"), "contains no trained human; allowed: a folder of")
    assert_refused(
        run("train", FEEDING, "--people", human, "--out", tmp_path / "no"), "this human was trained for"
    )
    assert_refused(run("view", FEEDING, "--people", human, "--port", 0), "this human was trained for")
    assert_refused(
        run("train", SCRATCHING, "--recipe", "pair", "--people", human, "--out", tmp_path / "no"),
        "is a trained human, but `--recipe pair` trains a new one",
    )
    assert not (tmp_path / "no").exists()


def test_a_recurrent_human_is_refused(tmp_path):
    from avrgym.networks.layers import GatedRecurrentUnit

    plain = random_network(SCRATCHING)
    size, joints = plain.observation_size, plain.action_size
    memory = GatedRecurrentUnit(np.zeros((size, 3)), np.zeros(3), np.zeros((1, 3)), np.zeros(3))
    remembering = replace(plain, weights=(np.zeros((size + 1, joints)),), memory=memory)
    path = save_network(tmp_path / "human.safetensors", remembering)
    with pytest.raises(PolicyError, match="is a recurrent policy; allowed"):
        find_populations(path, TASKS)


def test_options_of_pairs_need_the_recipe(trained, tmp_path):
    new = "train", SCRATCHING, "--out", tmp_path / "no"
    for option in (("--alternate", 2), ("--own-reward",)):
        assert_refused(run(*new, *option), f"{option[0]} needs --recipe pair")
        again = "train", SCRATCHING, "--recipe", "pair", "--resume", "--out", trained, *option
        assert_refused(run(*again), f"--resume does not accept {option[0]}")
    resumed = "train", FEEDING, "--recipe", "pair", "--resume", "--out", trained
    assert_refused(run(*resumed), f"contains a training run of {SCRATCHING}, not of {FEEDING}")
    alone = tmp_path / "alone"
    alone.mkdir()
    configuration = json.loads((trained / "configuration.json").read_text())
    (alone / "configuration.json").write_text(json.dumps(configuration | {"pairing": None}))
    resumed = "train", SCRATCHING, "--recipe", "pair", "--resume", "--out", alone
    assert_refused(run(*resumed), "contains no training run with --recipe pair")
    assert not (tmp_path / "no").exists()


def test_a_task_without_human_actions_trains_no_human(tmp_path, monkeypatch):
    monkeypatch.setitem(TASKS, "ScratchItch", replace(TASKS["ScratchItch"], offered_body_part="nothing"))
    with pytest.raises(ValueError, match="people have no actions in"):
        train(PAIR, tmp_path / "no")
    assert not (tmp_path / "no").exists()


def test_files_of_robots_contain_no_human_metadata(tmp_path):
    path = tmp_path / "robot.safetensors"
    save_network(path, random_network(SCRATCHING, of_human=False))
    assert b'"human"' not in path.read_bytes()
    assert Policy.load(path).metadata == random_network(SCRATCHING, of_human=False).metadata
