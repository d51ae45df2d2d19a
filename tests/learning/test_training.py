import json
import shutil
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from typer.testing import CliRunner

from helpers.system.paths import DATA

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

from avrgym.cli.main import app
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.learning import recurrent_recipe, training
from avrgym.learning.configuration import (
    FeedforwardConfiguration,
    JointTrainingSettings,
    RecurrentConfiguration,
    write_configuration,
)
from avrgym.learning.hyperparameter_files import format_hyperparameters, read_hyperparameters
from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS, make_hyperparameters
from avrgym.learning.normaliser import Normaliser, make_observation_description
from avrgym.learning.ppo import Agent, export_policy, make_ppo
from avrgym.learning.rollouts import Rollout, RolloutRequest, WorldSettings, load_cached_worlds, roll_out
from avrgym.learning.stable_baselines import SB3VectorEnv
from avrgym.learning.training import (
    TrainingProgress,
    make_feedforward_configuration,
    read_configuration,
    resume_training,
    train,
    with_metadata,
)
from avrgym.policies.trained_policies import Policy, PolicyMetadata, find_policy_file
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.scratch_itch.detour import compute_tool_and_hand_detour_m

pytestmark = pytest.mark.usefixtures("one_thread")

FEEDING = "avrgym/FeedingJaco-v1"
SCRATCHING = "avrgym/ScratchItchJaco-v1"
WORLDS = 3
TINY = FeedforwardConfiguration(
    environment=SCRATCHING,
    people="zoo/train",
    impairment="weakness",
    steps=2 * WORLDS * EPISODE_STEPS,
    seed=4,
    num_envs=WORLDS,
    batch_size=200,
    n_epochs=2,
    threads=1,
    imitation_rounds=0,
)
UPDATE = WORLDS * EPISODE_STEPS
LONG = replace(
    TINY, people="revised", impairment="none", steps=4 * UPDATE, imitation_rounds=2, imitation_share=0.5
)
HARD = replace(TINY, steps=3 * UPDATE, hard_share=0.5)


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> tuple[Policy, Path]:
    """A training of two updates, and its folder."""
    out = tmp_path_factory.mktemp("runs") / "tiny"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "EVALUATION_EPISODES", 2)
        return train(TINY, out), out


# The settings


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_schedules_are_linear(environment):
    how = make_feedforward_configuration(environment, "revised", 1_000_000, 0)
    steps = np.linspace(how.imitation_steps, how.steps, 31)
    log_std, rate, weight = (
        np.array([at(step) for step in steps])
        for at in (how.compute_log_std, how.compute_learning_rate, how.compute_force_weight)
    )
    assert_allclose(log_std, np.linspace(*how.log_std, 31))
    assert_allclose(rate[[0, 15, 30]], how.learning_rate * np.array([1.0, 0.5, 0.01]))
    assert (np.diff(rate) < 0.0).all()
    assert_allclose(
        weight[[0, 10, 15, 20, 30]], how.force_weight_per_n * np.array([0.0, 0.0, 0.5, 1.0, 1.0]), atol=1e-12
    )
    assert [at(0) for at in (how.compute_log_std, how.compute_learning_rate)] == [log_std[0], rate[0]]


# The wrapper


def test_the_wrapper_reports_terminal_observations_only_at_the_end():
    env = SB3VectorEnv(AssistiveVectorEnv(FEEDING, 3, num_threads=1))
    reference = AssistiveVectorEnv(FEEDING, 3, num_threads=1)
    env.seed(5)
    assert_array_equal(env.reset(), reference.reset(seed=5)[0])
    still = np.zeros((3, 7), np.float32)
    returns = np.zeros(3)
    for _ in range(199):
        _, reward, done, infos = env.step(still)
        returns += reward
        reference.step(still)
        assert not done.any()
        assert infos == [{}, {}, {}]
    observation, reward, done, infos = env.step(still)
    expected_observation, expected_reward, _, _, last = reference.step(still)
    assert done.all()
    assert_array_equal(observation, expected_observation)
    assert_array_equal(reward, expected_reward)
    for i, info in enumerate(infos):
        assert info["TimeLimit.truncated"] is True
        assert info["success"] is False
        assert info["episode_return"] == pytest.approx(returns[i] + np.asarray(reward)[i])
        assert_array_equal(info["terminal_observation"], last["final_obs"][i])
        assert not np.array_equal(info["terminal_observation"], np.asarray(observation)[i])


def test_the_wrapper_resets_to_other_episodes():
    env = SB3VectorEnv(AssistiveVectorEnv(FEEDING, 2, num_threads=1))
    env.seed(5)
    first = env.reset()
    assert not np.array_equal(env.reset(), first)
    env.seed(5)
    assert_array_equal(env.reset(), first)


# Training


@pytest.mark.slow
def test_a_training_writes_a_policy_that_loads(trained):
    policy, out = trained
    found = Policy.load(out / "policy.safetensors")
    assert found.metadata == policy.metadata
    assert found.metadata.environment == SCRATCHING
    assert (found.metadata.people, found.metadata.impairment) == ("zoo/train", "weakness")
    assert found.metadata.seed == 4
    assert 0 < found.metadata.steps <= TINY.steps
    assert set(found.metadata.measured) >= {"success_rate", "reward_mean", "force_mean_newton"}
    assert found.compute_mean_actions(np.zeros((2, 30))).shape == (2, 7)


@pytest.mark.slow
def test_a_training_stores_its_configuration_and_its_log(trained):
    _, out = trained
    assert json.loads((out / "configuration.json").read_text())["batch_size"] == TINY.batch_size
    assert list((out / "tensorboard").rglob("events.out.tfevents.*"))


@pytest.mark.slow
def test_a_used_folder_is_refused_and_not_changed(trained):
    _, out = trained
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(FileExistsError, match="already contains a training run; choose another folder"):
        train(TINY, out)
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


@pytest.mark.slow
def test_scratching_improves_within_20_000_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 2)
    few = FeedforwardConfiguration(
        environment=SCRATCHING, people="revised", steps=20_000, seed=1, num_envs=8, batch_size=200, imitation_rounds=0,
        log_std=(-0.7, -1.0), threads=1,
    )  # fmt: skip
    reported: list[TrainingProgress] = []
    train(few, tmp_path, reported.append)
    rewards = [progress.reward_mean for progress in reported if progress.reward_mean is not None]
    assert np.mean(rewards[-3:]) > np.mean(rewards[:3]) + 5.0


class Killed(Exception):
    """The training was killed."""


Whole = tuple[Path, list[TrainingProgress]]
"""The folder of an uninterrupted training, and its progress."""


def train_whole(configuration: FeedforwardConfiguration, out: Path) -> Whole:
    reported: list[TrainingProgress] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(training, "EVALUATION_EPISODES", 2)
        train(configuration, out, reported.append)
    return out, reported


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Whole:
    """Two rounds of imitation and two updates."""
    out, reported = train_whole(LONG, tmp_path_factory.mktemp("runs") / "whole")
    assert [(progress.stage, progress.num_timesteps) for progress in reported] == [
        *((f"imitation, update {number} of 4", UPDATE * number) for number in (1, 2)),
        *((f"PPO, update {number} of 4", UPDATE * number) for number in (3, 4)),
        ("evaluation, 2 episodes", 4 * UPDATE),
    ]  # fmt: skip
    assert reported[0].reward_mean is None
    return out, reported


@pytest.mark.slow
@pytest.mark.parametrize("kill_at", [1, 3], ids=["in its imitation", "in PPO"])
def test_an_interrupted_training_resumes_to_the_same_weights(kill_at, whole, tmp_path, monkeypatch):
    assert_resumes_equally(LONG, kill_at, whole, tmp_path, monkeypatch)


@pytest.mark.slow
def test_an_interrupted_training_resumes_with_its_hard_episodes(tmp_path, monkeypatch):
    uncut = train_whole(HARD, tmp_path / "whole")
    assert_resumes_equally(HARD, 2, uncut, tmp_path, monkeypatch)
    assert json.loads(torch.load(uncut[0] / "checkpoint.pt", weights_only=True)["notes"])["hard"]


def assert_resumes_equally(
    configuration: FeedforwardConfiguration, kill_at: int, whole: Whole, tmp_path: Path, monkeypatch
) -> None:
    """Assert that a training that is killed at a report resumes equally."""
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 2)
    reported: list[TrainingProgress] = []

    def kill(progress: TrainingProgress) -> None:
        reported.append(progress)
        if len(reported) == kill_at:
            raise Killed

    with pytest.raises(Killed):
        train(configuration, tmp_path / "cut", kill)
    resume_training(tmp_path / "cut", reported.append)
    uncut, expected = whole
    assert reported == expected
    first, second = (
        torch.load(out / "checkpoint.pt", weights_only=True) for out in (tmp_path / "cut", uncut)
    )
    for part in ("policy", "observations", "returns"):
        for name, value in first[part].items():
            assert_array_equal(np.asarray(value), np.asarray(second[part][name]), err_msg=name)
    assert json.loads(first["notes"])["hard"] == json.loads(second["notes"])["hard"]
    assert sorted(path.name for path in (tmp_path / "cut").iterdir()) == sorted(
        path.name for path in uncut.iterdir()
    )


@pytest.mark.slow
def test_a_training_can_consist_of_imitation_only(tmp_path, monkeypatch):
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 2)
    policy = train(replace(TINY, imitation_rounds=9, imitation_share=1.0), tmp_path)
    assert policy.metadata.steps == TINY.steps
    assert policy.metadata.measured["episodes"] == 2
    assert policy.action_std == pytest.approx(np.exp(TINY.log_std[0]))
    with pytest.raises(
        ValueError,
        match=f"is complete after {TINY.steps} steps; set --steps to a larger number to continue it",
    ):
        resume_training(tmp_path)


@pytest.mark.slow
def test_a_complete_training_continues_with_larger_steps(trained, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 2)
    first, out = trained
    longer = Path(shutil.copytree(out, tmp_path / "longer"))
    with pytest.raises(
        ValueError, match=f"has completed {TINY.steps} steps; allowed for --steps: a larger number"
    ):
        resume_training(longer, steps=TINY.steps - 1)
    policy = resume_training(longer, steps=TINY.steps + 1)
    assert policy.metadata.steps == 3 * UPDATE
    assert policy.metadata.curve[:2] == first.metadata.curve
    assert read_configuration(longer) == replace(TINY, steps=TINY.steps + 1, imitation_share=1.0)
    with pytest.raises(ValueError, match=f"is complete after {3 * UPDATE} steps"):
        resume_training(longer)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_longer_training_has_no_more_imitation(environment):
    how = make_feedforward_configuration(environment, "revised", 300_000, 0)
    assert how.with_steps(900_000).imitation_steps == how.imitation_steps


# Files of settings


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_printed_hyperparameters_are_those_of_the_environment(environment, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(format_hyperparameters(environment))
    assert read_hyperparameters(file, environment) == make_hyperparameters(environment)
    file.write_text("")
    assert read_hyperparameters(file, environment) == make_hyperparameters(environment)


def test_a_file_replaces_hyperparameters_of_the_task(tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text("num_envs = 4\nhidden = [16]\n")
    how = make_feedforward_configuration(
        FEEDING, "revised", 1000, 0, hyperparameters=read_hyperparameters(file, FEEDING)
    )
    assert (how.num_envs, how.net_arch, how.log_std) == (4, (16,), make_hyperparameters(FEEDING).log_std)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("num_envs = 0", "num_envs: expected `int` >= 1"),
        ("net_arch = []", "net_arch: expected `array` of length >= 1"),
        ("net_arch = [8, 0.5]", r"net_arch\[1\]: expected `int`"),
        ("gamma = 1.5", "gamma: expected `float` <= 1.0"),
        ("learning_rate = nan", "learning_rate is not finite; allowed: a finite number"),
        ("log_std = [1.0]", "log_std: expected `array` of length 2"),
        ("wrolds = 8", "unknown hyperparameter wrolds; allowed: num_envs, batch_size"),
        ("steps = 8", "unknown hyperparameter steps"),
        ("worlds", "invalid TOML: "),
    ],
)
def test_an_invalid_file_of_hyperparameters_is_refused(text, said, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(text)
    with pytest.raises(ValueError, match=rf"settings\.toml: {said}"):
        read_hyperparameters(file, FEEDING)


@pytest.mark.slow
def test_damaged_demonstrations_are_named(tmp_path):
    def kill(progress: TrainingProgress) -> None:
        if progress.num_timesteps >= UPDATE:
            raise Killed

    with pytest.raises(Killed):
        train(LONG, tmp_path, kill)
    (tmp_path / "shown" / "round_0000.npz").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"round_0000\.npz: not a file of demonstrations"):
        resume_training(tmp_path)


def test_only_an_interrupted_training_resumes(trained, tmp_path):
    _, out = trained
    with pytest.raises(ValueError, match=f"is complete after {TINY.steps} steps"):
        resume_training(out)
    with pytest.raises(ValueError, match="contains no training"):
        resume_training(tmp_path)
    (tmp_path / "configuration.json").write_bytes((out / "configuration.json").read_bytes())
    (tmp_path / "checkpoint.pt").write_bytes((out / "checkpoint.pt").read_bytes()[:1000])
    with pytest.raises(ValueError, match=r"checkpoint\.pt: not a checkpoint of this training"):
        resume_training(tmp_path)


def test_an_unknown_environment_writes_nothing(tmp_path):
    with pytest.raises(ValueError, match="unknown environment 'avrgym/Flying-v1'"):
        train(FeedforwardConfiguration(environment="avrgym/Flying-v1"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_training_of_an_earlier_version_resumes(tmp_path):
    folder = Path(shutil.copytree(DATA / "training-of-0.2.0", tmp_path / "training"))
    before = read_configuration(folder)
    resume_training(folder, steps=before.steps + before.steps_per_update)
    assert read_configuration(folder).steps == before.steps + before.steps_per_update


def test_people_of_an_earlier_training_move_as_before(tmp_path):
    for configuration, before in ((TINY, "zoo/train@1"), (LONG, "revised")):
        write_configuration(configuration, tmp_path)
        assert read_configuration(tmp_path) == configuration
        path = tmp_path / "configuration.json"
        values = json.loads(path.read_text())
        del values["motion_version"]
        path.write_text(json.dumps(values))
        assert read_configuration(tmp_path).people == before


@pytest.mark.parametrize("stored", [{}, {"learning_version": 1}, {"learning_version": 3}])
def test_a_training_of_another_algorithm_is_refused(stored, tmp_path):
    (tmp_path / "configuration.json").write_text(json.dumps({"environment": FEEDING, **stored}))
    with pytest.raises(ValueError, match=r"learning version (None|1|3); allowed: 2"):
        read_configuration(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(2, 3), (1, 1, 3)])
def test_rollouts_do_not_depend_on_the_parts(sizes):
    """Parts give the same rollout as one request; with an expert in some worlds and without."""
    policy = Policy.load(find_policy_file("revised", SCRATCHING))
    by_expert = np.array([True, False, False, True, False])
    for how in ({"noise_seed": (3, 400)}, {"expert_drives": by_expert}):
        whole, parts = (
            Rollout.concatenate([roll_out(policy, request) for request in requests_of(split, how)])
            for split in ((5,), sizes)
        )
        for field in fields(Rollout):
            assert_array_equal(getattr(parts, field.name), getattr(whole, field.name), err_msg=field.name)
        arrays = (getattr(whole, field.name) for field in fields(Rollout))
        assert whole.nbytes == sum(array.nbytes for array in arrays if array is not None)


def expert_rollout(**weights: float) -> Rollout:
    """Two episodes that the task's expert drives."""
    (request,) = requests_of((2,), {"expert_drives": np.ones(2, bool)})
    weighted = replace(request, **{"force_weight_per_n": 0.0, "detour_weight_per_m": 0.0, **weights})
    return roll_out(Policy.load(find_policy_file("revised", SCRATCHING)), weighted)


@pytest.mark.slow
def test_force_on_the_person_is_subtracted_from_the_rewards():
    plain, weighted = expert_rollout(), expert_rollout(force_weight_per_n=0.5)
    cost = (plain.rewards - weighted.rewards).sum(axis=0)
    assert_allclose(cost, 0.5 * EPISODE_STEPS * plain.episode_mean_force_n, rtol=1e-4)
    assert plain.episode_mean_force_n.max() > 1.0


@pytest.mark.slow
def test_detours_are_subtracted_from_the_rewards_of_all_but_the_last_step():
    plain, weighted = expert_rollout(), expert_rollout(detour_weight_per_m=2.0)
    worlds = Episodes(SCRATCHING, 2, people="participants", impairment="tremor", num_threads=1)
    worlds.reset(
        np.arange(2), [np.random.default_rng(seed) for seed in requests_of((2,), {})[0].episode_seeds]
    )
    expected = np.zeros((EPISODE_STEPS, 2))
    for number, action in enumerate(plain.actions[:-1]):
        worlds.step(np.clip(action, -1.0, 1.0).astype(float))
        expected[number] = 2.0 * compute_tool_and_hand_detour_m(
            worlds.simulation.get_state(), worlds.task_state
        )
    assert_allclose(plain.rewards - weighted.rewards, expected, atol=1e-4)
    assert expected.max() > 0.1


def requests_of(split: tuple[int, ...], how: dict) -> list[RolloutRequest]:
    """Of five worlds, in parts of these sizes."""
    place = WorldSettings(SCRATCHING, TransferredFile.read("participants"), "tremor", 1, "threads")
    ends = np.cumsum(split)
    return [
        RolloutRequest(
            world_settings=place,
            first_world_index=int(end - size),
            episode_seeds=np.arange(50, 55)[end - size : end],
            noise_seed=how.get("noise_seed"),
            expert_controlled_mask=how["expert_drives"][end - size : end] if "expert_drives" in how else None,
            force_weight_per_n=0.1,
            detour_weight_per_m=5.0,
        )
        for size, end in zip(split, ends, strict=True)
    ]


def test_too_many_worlds_for_the_memory_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"worlds need .* of memory; this computer has .*allowed: .* worlds"):
        train(replace(TINY, num_envs=10**9), tmp_path / "many")
    assert not (tmp_path / "many").exists()


# The force guard


@pytest.mark.slow
@pytest.mark.parametrize(
    "configuration",
    [
        replace(TINY, steps=2 * UPDATE, force_guard=True),
        replace(TINY, steps=2 * UPDATE, force_guard=True, pairing=JointTrainingSettings()),
        RecurrentConfiguration(
            environment=SCRATCHING, steps=400, num_envs=1, memory_size=4, net_arch=(8,), threads=1,
            imitation_share=0.5, force_guard=True,
        ),
    ],
    ids=["imitation and PPO", "pair", "adaptive"],
)  # fmt: skip
def test_each_recipe_trains_with_the_force_guard_and_resumes(configuration, tmp_path, monkeypatch):
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    monkeypatch.setattr(
        recurrent_recipe,
        "RECURRENT_HYPERPARAMETERS",
        replace(RECURRENT_HYPERPARAMETERS, gradient_steps=1, final_round_gradient_steps=1),
    )
    guards = []

    def worlds(*arguments, **named):
        made = load_cached_worlds(*arguments, **named)
        guards.append(made.control_loop.guard)
        return made

    monkeypatch.setattr("avrgym.learning.rollouts.load_cached_worlds", worlds)

    def kill(progress: TrainingProgress) -> None:
        raise Killed

    with pytest.raises(Killed):
        train(configuration, tmp_path, kill)
    policy = resume_training(tmp_path)
    assert len(guards) >= 2
    assert all(guard is not None for guard in guards)
    assert read_configuration(tmp_path).force_guard
    assert Policy.load(tmp_path / "policy.safetensors").metadata.force_guard
    assert "guard_interventions" in policy.metadata.measured


@pytest.mark.slow
def test_evaluate_reports_that_a_policy_was_trained_with_the_guard(tmp_path):
    policy = Policy.load(find_policy_file("revised", SCRATCHING))
    path = str(tmp_path / "guarded.safetensors")
    with_metadata(policy, force_guard=True).save(path)
    for file, options, warned in ((path, [], True), (path, ["--force-guard"], False), ("revised", [], False)):
        arguments = ["evaluate", SCRATCHING, "--policy", file, "--episodes", "1", "--jobs", "1", *options]
        result = CliRunner().invoke(app, arguments)
        assert result.exit_code == 0, result.stderr
        assert ("was trained with the force guard" in result.stderr) == warned


# The exported policy


def test_the_exported_policy_acts_as_the_model_does(rng, tmp_path):
    """Also where observations are clipped, and after the normaliser was updated."""
    model = make_ppo(replace(TINY, environment=FEEDING), 25, 7, tmp_path)
    normaliser = Normaliser(make_observation_description(FEEDING), TINY.gamma)
    (request,) = requests_of((2,), {})
    place = replace(
        request.world_settings, environment=FEEDING, people=TransferredFile.read("revised"), impairment="none"
    )
    rollout = roll_out(
        Policy.load(find_policy_file("revised", FEEDING)), replace(request, world_settings=place)
    )
    normaliser.update_observations(rollout)
    observations = np.concatenate([rollout.observations[:, 0], rng.uniform(-3, 3, (200, 25))])
    normalised = normaliser.normalize_obs(observations)
    expected, _ = model.predict(normalised, deterministic=True)
    metadata = PolicyMetadata(environment=FEEDING, people="", steps=0, seed=0)
    exported = export_policy(Agent(model, normaliser), TINY.log_std[0], metadata)
    assert_allclose(np.clip(exported.compute_mean_actions(observations), -1.0, 1.0), expected, atol=1e-5)
    assert exported.action_std == pytest.approx(np.exp(TINY.log_std[0]))
    assert np.abs(normalised).max() == 5.0
