import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

from avrgym.learning import configuration as configurations
from avrgym.learning import recurrent_recipe, training
from avrgym.learning.configuration import RecurrentConfiguration, read_configuration
from avrgym.learning.hyperparameters import RECURRENT_HYPERPARAMETERS
from avrgym.learning.normaliser import Normaliser, make_observation_description
from avrgym.learning.recurrent_network import RecurrentNetwork
from avrgym.learning.rollouts import RolloutRequest, WorldSettings, roll_out
from avrgym.learning.training import resume_training, train
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.policies.actors import Actor
from avrgym.policies.trained_policies import Policy, PolicyMetadata, find_packaged_policies
from avrgym.safety.limits import TRANSIENT_LIMIT_N
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, get_observation_and_action_size

pytestmark = pytest.mark.usefixtures("one_thread")

JUMPING = "participants@1"
"""People who press hard, because their joint targets jump."""

TINY = RecurrentConfiguration(
    environment="avrgym/ScratchItchJaco-v1",
    steps=1000,
    seed=4,
    num_envs=1,
    memory_size=8,
    net_arch=(8,),
    threads=1,
)


class Interrupted(Exception):
    pass


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    short = replace(
        RECURRENT_HYPERPARAMETERS, gradient_steps=3, final_round_gradient_steps=3, critic_only_updates=1
    )
    for module in (configurations, recurrent_recipe):
        monkeypatch.setattr(module, "RECURRENT_HYPERPARAMETERS", short)


def packaged(environment: str, kind: str) -> Policy:
    return Policy.load(find_packaged_policies(environment)[kind])


def tensors(out: Path) -> bytes:
    """A policy's tensors, without the header."""
    data = (out / "policy.safetensors").read_bytes()
    return data[8 + int.from_bytes(data[:8], "little") :]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("last", "how", "imitated"),
    [
        (200, {}, 2),
        (600, {}, 2),
        (200, {"teacher": "revised"}, 2),
        (400, {"initial": "adaptive", "imitation_share": None}, 0),
        (200, {"initial": "adaptive"}, 2),
    ],
    ids=[
        "in imitation",
        "in PPO",
        "in imitation of a policy",
        "having gone on from a policy",
        "in imitation from a policy on",
    ],
)
def test_a_resumed_training_ends_with_the_same_bits(last, how, imitated, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    configuration = replace(TINY, **{"imitation_share": 0.4, **how})
    assert (configuration.total_updates, configuration.imitation_updates) == (5, imitated)
    policy = train(configuration, whole)
    before = packaged(TINY.environment, "adaptive") if "initial" in how else None
    assert policy.metadata.steps == 1000 + (0 if before is None else before.metadata.steps)
    if before is not None:
        assert_allclose(policy.observation_mean, before.observation_mean)
    assert policy.metadata.measured["episodes"] == 1
    assert policy.action_std in RECURRENT_HYPERPARAMETERS.candidate_action_stds

    def stop(progress):
        if progress.steps == last:
            raise Interrupted

    with pytest.raises(Interrupted):
        train(configuration, cut, stop)
    assert json.loads((cut / "adaptive.json").read_text())["seed"] == 4
    assert (cut / "checkpoint.pt").exists()
    torch.manual_seed(99)
    resume_training(cut)
    assert tensors(cut) == tensors(whole)
    with pytest.raises(ValueError, match="complete"):
        resume_training(cut)
    with pytest.raises(FileExistsError, match="already contains a training run"):
        train(configuration, cut)


@pytest.mark.slow
def test_training_resumes_without_the_original_people_file(tmp_path):
    people = tmp_path / "people.toml"
    people.write_text("cooperating = false\n[torso_height_m]\nman = [0.51, 0.52]\nwoman = [0.51, 0.52]\n")

    def stop(progress):
        raise Interrupted

    with pytest.raises(Interrupted):
        train(replace(TINY, people=str(people)), tmp_path / "run", stop)
    people.unlink()
    resume_training(tmp_path / "run")
    assert (tmp_path / "run" / "policy.safetensors").exists()


def test_ppo_progress_starts_after_imitation_and_ends_with_the_last_update():
    configuration = RecurrentConfiguration(environment=TINY.environment)
    first = configuration.imitation_updates + 1
    assert configuration.imitation_updates == round(
        RECURRENT_HYPERPARAMETERS.imitation_share * configuration.total_updates
    )
    assert configuration.compute_ppo_progress(0) == configuration.compute_ppo_progress(first) == 0.0
    assert 0.9 < configuration.compute_ppo_progress(configuration.total_updates - 1) < 1.0


@pytest.mark.parametrize("rounds", [1, 2, 25, 63])
def test_a_longer_training_has_as_much_imitation(rounds):
    configuration = replace(TINY, steps=200 * rounds, imitation_share=0.25)
    for more in (0, 1, 10, 100):
        longer = configuration.with_steps(200 * (rounds + more))
        assert (longer.total_updates, longer.imitation_updates) == (
            rounds + more,
            configuration.imitation_updates,
        )
    with pytest.raises(ValueError, match="but the training run has"):
        configuration.with_steps(200 * rounds - 200)


@pytest.mark.slow
def test_the_best_action_std_is_kept_and_the_least_of_equals(tmp_path, monkeypatch):
    success_with = {0.0: 0.2, 0.05: 0.6, 0.08: 0.6}
    assert tuple(success_with) == RECURRENT_HYPERPARAMETERS.candidate_action_stds

    def evaluated(environment, path, *_, **__):
        return SimpleNamespace(
            **dict.fromkeys(training.STORED_RESULT_NAMES, 0.0)
            | {"success_rate": success_with[Policy.load(path).action_std]}
        )

    monkeypatch.setattr(training, "evaluate", evaluated)
    out = tmp_path / "out"
    train(replace(TINY, steps=200, imitation_share=1.0), out)
    kept = Policy.load(out / "policy.safetensors")
    assert (kept.action_std, kept.metadata.measured["success_rate"]) == (0.05, 0.6)


@pytest.mark.slow
def test_a_complete_training_continues_with_more_steps(tmp_path):
    out = tmp_path / "out"
    train(replace(TINY, steps=400, imitation_share=0.5), out)
    before = tensors(out)
    policy = resume_training(out, steps=800)
    assert policy.metadata.steps == read_configuration(out).steps == 800
    assert read_configuration(out).imitation_updates == 1
    assert tensors(out) != before


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_the_policy_in_numpy_equals_the_network_in_torch(environment):
    observation_size, action_size = get_observation_and_action_size(environment)
    torch.manual_seed(1)
    network = RecurrentNetwork(observation_size, 12, (9, 8), action_size)
    normaliser = Normaliser(make_observation_description(environment), 0.99)
    policy = network.to_policy(
        normaliser, PolicyMetadata(environment=environment, people="", steps=0, seed=0)
    )
    observations = np.random.default_rng(2).standard_normal((30, 4, observation_size))
    with torch.no_grad():
        means, _ = network(torch.as_tensor(normaliser.normalize_obs(observations)))
    actor = Actor(policy, 4)
    assert_allclose(
        np.stack([actor.compute_mean_actions(each) for each in observations]), means.numpy(), atol=1e-6
    )


def test_memory_continues_between_windows():
    torch.manual_seed(1)
    network = RecurrentNetwork(5, 6, (4,), 2)
    observations = torch.randn(20, 3, 5)
    with torch.no_grad():
        whole, _ = network(observations)
        first, remembered = network(observations[:10])
        second, _ = network(observations[10:], remembered)
    assert_allclose(torch.cat([first, second]).numpy(), whole.numpy(), atol=1e-6)


def test_demonstrations_are_the_teacher_s_actions():
    teacher, learner = (packaged(TINY.environment, kind) for kind in ("revised", "original"))
    settings = WorldSettings(TINY.environment, TransferredFile.read(TINY.people), "none", 1, "threads")
    by_expert = np.array([True, False])
    shown = roll_out(
        learner, RolloutRequest(settings, 0, np.arange(2), expert_controlled_mask=by_expert, teacher=teacher)
    )
    for seen, done in zip(shown.observations[:-1], shown.actions, strict=True):
        assert_allclose(done, np.clip(Actor(teacher, 2).compute_mean_actions(seen), -1.0, 1.0), atol=1e-4)


@pytest.mark.parametrize(
    ("name", "message"), [("nobody", "allowed"), ("oracle", "allowed"), ("original", "trained for")]
)
def test_an_unsuitable_teacher_is_refused_before_anything_is_written(name, message, tmp_path):
    wrong = tmp_path / "PR2.safetensors"
    packaged("avrgym/ScratchItchPR2-v1", "original").save(wrong)
    teacher = str(wrong) if name == "original" else name
    with pytest.raises(ValueError, match=message):
        train(replace(TINY, teacher=teacher), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nobody", "no policy 'nobody'"),
        ("oracle", "a recurrent policy"),
        ("revised", "a recurrent policy"),
        ("adaptive", "trained for"),
    ],
)
def test_an_unsuitable_initial_policy_is_refused_before_anything_is_written(name, message, tmp_path):
    wrong = tmp_path / "PR2.safetensors"
    packaged("avrgym/ScratchItchPR2-v1", "adaptive").save(wrong)
    initial = str(wrong) if name == "adaptive" else name
    with pytest.raises(ValueError, match=message):
        train(replace(TINY, initial=initial), tmp_path / "out")
    with pytest.raises(ValueError, match="remove the teacher"):
        train(replace(TINY, initial="adaptive", teacher="revised"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_training_starts_from_the_initial_policy(tmp_path):
    """While only the critic learns, the policy does not change."""
    train(replace(TINY, steps=200, initial="adaptive"), tmp_path / "out")
    before, after = (
        packaged(TINY.environment, "adaptive"),
        Policy.load(tmp_path / "out" / "policy.safetensors"),
    )
    seen = np.random.default_rng(3).standard_normal((20, 2, before.observation_size))
    there, here = Actor(before, 2), Actor(after, 2)
    for each in seen:
        assert_allclose(here.compute_mean_actions(each), there.compute_mean_actions(each), atol=1e-6)
    assert after.metadata.curve[: len(before.metadata.curve)] == before.metadata.curve


def test_the_overload_penalty_follows_the_most_loaded_region():
    environment, steps, seeds = "avrgym/FeedingPR2-v1", 40, [0, 1, 2]
    policy = packaged(environment, "revised")
    settings = WorldSettings(
        environment, TransferredFile.read(JUMPING), "none", 1, "threads", episode_steps=steps
    )
    requests = [
        RolloutRequest(settings, 0, np.array(seeds), overload_weight=weight) for weight in (0.0, 1.0, 3.0)
    ]
    free, once, thrice = (roll_out(policy, request) for request in requests)
    assert free.observations.tobytes() == once.observations.tobytes()
    cost = free.rewards - once.rewards
    assert_allclose(free.rewards - thrice.rewards, 3.0 * cost, atol=1e-4)

    worlds = Episodes(environment, len(seeds), people=JUMPING, by_region=True, num_threads=1)
    watch, actor = RegionLoadRecorder(len(seeds)), Actor(policy, len(seeds))
    seen = worlds.reset(np.arange(len(seeds)), [np.random.default_rng(seed) for seed in seeds])
    for _ in range(steps):
        action = np.clip(actor.compute_mean_actions(seen.astype(np.float32)), -1.0, 1.0).astype(np.float32)
        worlds.command_robots(action)
        for substep in range(DEFAULT_SUBSTEPS):
            worlds.step_physics(substep, 1)
            watch.add_forces(worlds.simulation.compute_region_force_n())
        seen = worlds.evaluate_step(action).observation
    peak_share = (watch.compute_loads().peak_force_n / TRANSIENT_LIMIT_N).max(axis=-1)
    assert peak_share.max() > 0.5
    assert_allclose(cost.max(axis=0), np.maximum(2.0 * peak_share - 1.0, 0.0), atol=1e-4)


def test_force_beyond_the_limit_is_not_rewarded():
    """Scratching pays 2 for each newton of a scratch and 0.01 for each at the itch."""
    environment, steps, seeds, most = TINY.environment, 60, np.arange(2), 3.0
    policy = packaged(environment, "revised")
    settings = WorldSettings(
        environment, TransferredFile.read("revised"), "none", 1, "threads", episode_steps=steps
    )
    free, limited = (
        roll_out(policy, RolloutRequest(settings, 0, seeds, max_rewarded_force_n=each))
        for each in (np.inf, most)
    )
    worlds, actor = Episodes(environment, 2, people="revised", num_threads=1), Actor(policy, 2)
    seen, taken_off = worlds.reset(np.arange(2), [np.random.default_rng(seed) for seed in seeds]), []
    for _ in range(steps):
        action = np.clip(actor.compute_mean_actions(seen.astype(np.float32)), -1.0, 1.0).astype(np.float32)
        step = worlds.step(action)
        seen, terms = step.observation, step.reward_terms
        beyond = [np.maximum(terms[name] - most, 0.0) for name in ("scratch_force_n", "force_at_itch_n")]
        taken_off.append(2.0 * beyond[0] + 0.01 * beyond[1])
    assert np.max(taken_off) > 1.0
    assert_allclose(free.rewards - limited.rewards, taken_off, atol=1e-4)


def test_a_folder_without_training_is_refused(tmp_path):
    with pytest.raises(ValueError, match="contains no training"):
        resume_training(tmp_path)


@pytest.mark.slow
def test_withdrawal_gives_no_reward_and_demonstrates_waiting():
    settings = WorldSettings("avrgym/FeedingJaco-v1", TransferredFile.read("revised"), "none", 1, "threads")
    request = RolloutRequest(settings, 0, np.array([3]), expert_controlled_mask=np.array([True]))
    policy = packaged("avrgym/FeedingJaco-v1", "adaptive")
    goes_on = roll_out(policy, request)
    waits = roll_out(policy, replace(request, world_settings=replace(settings, withdraw_after_success=True)))
    assert goes_on.success.all()
    assert waits.success.all()
    assert (goes_on.rewards[-20:] != 0.0).all()
    assert np.abs(goes_on.actions[-20:]).max() > 0.0
    assert (waits.rewards[-20:] == 0.0).all()
    assert (waits.actions[-20:] == 0.0).all()


@pytest.mark.slow
def test_every_other_round_of_imitation_has_still_people(tmp_path, monkeypatch):
    met: list[tuple[str, str]] = []

    def rolled_out(policy, request):
        met.append((request.settings.people.name, request.settings.impairment))
        return roll_out(policy, request)

    monkeypatch.setattr(recurrent_recipe, "roll_out", rolled_out)
    train(replace(TINY, steps=800, imitation_share=1.0), tmp_path / "training")
    assert met == [("zoo/train", "none"), ("revised", "none"), ("zoo/train", "limits"), ("revised", "none")]
