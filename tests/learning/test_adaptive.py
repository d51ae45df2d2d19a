import json
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from numpy.testing import assert_allclose

pytest.importorskip("stable_baselines3", reason="training is an extra")

import torch

from avrgym.learning import adaptive
from avrgym.learning.adaptive import AdaptiveTraining, lengthened, resume, stored_training, train
from avrgym.learning.recurrent import RecurrentNetwork
from avrgym.learning.rollouts import Order, Place, roll_out
from avrgym.learning.updates import UpdateNormaliser, observation_of
from avrgym.models.scene import SUBSTEPS
from avrgym.policies.actors import Actor
from avrgym.policies.trained import Policy, PolicyMetadata, packaged_policies
from avrgym.safety.limits import TRANSIENT_LIMIT_N
from avrgym.safety.region_forces import RegionWatch
from avrgym.system.transferred_files import TransferredFile
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, sizes

pytestmark = pytest.mark.usefixtures("one_thread")

TINY = AdaptiveTraining(
    environment="avrgym/ScratchItchJaco-v1", steps=1000, seed=4, worlds=1, memory=8, hidden=(8,), threads=1
)


class CutOffError(Exception):
    pass


@pytest.fixture(autouse=True)
def _short(monkeypatch):
    for name, value in {"MEASURED_EPISODES": 1, "PASSES": 3, "LAST_PASSES": 3, "CRITIC_ROUNDS": 1}.items():
        monkeypatch.setattr(adaptive, name, value)


def packaged(environment: str, kind: str) -> Policy:
    return Policy.load(packaged_policies(environment)[kind])


def tensors(out: Path) -> bytes:
    """A policy's numbers; its header says how long it took."""
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
def test_resumed_it_ends_at_the_same_bits_as_uninterrupted(last, how, imitated, tmp_path):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    training = replace(TINY, **{"imitation_share": 0.4, **how})
    assert (training.rounds, training.imitation_rounds) == (5, imitated)
    policy = train(training, whole)
    before = packaged(TINY.environment, "adaptive") if "initial" in how else None
    assert policy.metadata.steps == 1000 + (0 if before is None else before.metadata.steps)
    if before is not None:
        assert_allclose(policy.observation_mean, before.observation_mean)
    assert policy.metadata.measured["episodes"] == 1
    assert policy.action_deviation in adaptive.CHANCES

    def stop(progress):
        if progress.steps == last:
            raise CutOffError

    with pytest.raises(CutOffError):
        train(training, cut, stop)
    assert json.loads((cut / "adaptive.json").read_text())["seed"] == 4
    assert (cut / "checkpoint.pt").exists()
    torch.manual_seed(99)
    resume(cut)
    assert tensors(cut) == tensors(whole)
    with pytest.raises(ValueError, match="complete"):
        resume(cut)
    with pytest.raises(FileExistsError, match="not empty"):
        train(training, cut)


def test_ppo_follows_imitation_and_ends_with_its_last_round():
    training = AdaptiveTraining(environment=TINY.environment)
    first = training.imitation_rounds + adaptive.CRITIC_ROUNDS
    assert training.imitation_rounds == round(adaptive.IMITATION_SHARE * training.rounds)
    assert training.ppo_share(0) == training.ppo_share(first) == 0.0
    assert 0.9 < training.ppo_share(training.rounds - 1) < 1.0


@pytest.mark.parametrize("rounds", [1, 2, 25, 63])
def test_a_longer_training_imitates_as_long(rounds):
    training = replace(TINY, steps=200 * rounds, imitation_share=0.25)
    for more in (0, 1, 10, 100):
        longer = lengthened(training, 200 * (rounds + more))
        assert (longer.rounds, longer.imitation_rounds) == (rounds + more, training.imitation_rounds)
    with pytest.raises(ValueError, match="fewer than the training's"):
        lengthened(training, 200 * rounds - 200)


@pytest.mark.slow
def test_it_keeps_the_chance_with_which_it_succeeds_most_and_the_least_of_equals(tmp_path, monkeypatch):
    success_with = {0.0: 0.2, 0.05: 0.6, 0.08: 0.6}
    assert tuple(success_with) == adaptive.CHANCES

    def measured(path, *_):
        policy = Policy.load(path)
        told = {"success_rate": success_with[policy.action_deviation]}
        return replace(policy, metadata=msgspec.structs.replace(policy.metadata, measured=told))

    monkeypatch.setattr(adaptive, "measure", measured)
    out = tmp_path / "out"
    train(replace(TINY, steps=200, imitation_share=1.0), out)
    kept = Policy.load(out / "policy.safetensors")
    assert (kept.action_deviation, kept.metadata.measured["success_rate"]) == (0.05, 0.6)


@pytest.mark.slow
def test_a_training_that_has_ended_goes_on_with_more_steps(tmp_path):
    out = tmp_path / "out"
    train(replace(TINY, steps=400, imitation_share=0.5), out)
    before = tensors(out)
    policy = resume(out, steps=800)
    assert policy.metadata.steps == stored_training(out).steps == 800
    assert stored_training(out).imitation_rounds == 1
    assert tensors(out) != before


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_numpy_does_as_torch_does(environment):
    observation_size, action_size = sizes(environment)
    torch.manual_seed(1)
    network = RecurrentNetwork(observation_size, 12, (9, 8), action_size)
    normaliser = UpdateNormaliser(observation_of(environment), 0.99)
    policy = network.policy(normaliser, PolicyMetadata(environment=environment, people="", steps=0, seed=0))
    observations = np.random.default_rng(2).standard_normal((30, 4, observation_size))
    with torch.no_grad():
        means, _ = network(torch.as_tensor(normaliser.normalize_obs(observations)))
    actor = Actor(policy, 4)
    assert_allclose(np.stack([actor.mean(each) for each in observations]), means.numpy(), atol=1e-6)


def test_windows_begin_where_the_one_before_ended():
    torch.manual_seed(1)
    network = RecurrentNetwork(5, 6, (4,), 2)
    observations = torch.randn(20, 3, 5)
    with torch.no_grad():
        whole, _ = network(observations)
        first, remembered = network(observations[:10])
        second, _ = network(observations[10:], remembered)
    assert_allclose(torch.cat([first, second]).numpy(), whole.numpy(), atol=1e-6)


def test_what_is_shown_is_what_the_teacher_would_do():
    teacher, learner = (packaged(TINY.environment, kind) for kind in ("revised", "original"))
    place = Place(TINY.environment, TransferredFile.of(TINY.people), "none", 1, "threads")
    by_expert = np.array([True, False])
    shown = roll_out(learner, Order(place, 0, np.arange(2), by_expert=by_expert, teacher=teacher))
    for seen, done in zip(shown.observations[:-1], shown.actions, strict=True):
        assert_allclose(done, np.clip(Actor(teacher, 2).mean(seen), -1.0, 1.0), atol=1e-4)


@pytest.mark.parametrize(
    ("name", "told"), [("nobody", "allowed"), ("oracle", "allowed"), ("original", "trained for")]
)
def test_whoever_cannot_teach_is_refused_before_anything_is_written(name, told, tmp_path):
    wrong = tmp_path / "PR2.safetensors"
    packaged("avrgym/ScratchItchPR2-v1", "original").save(wrong)
    teacher = str(wrong) if name == "original" else name
    with pytest.raises(ValueError, match=told):
        train(replace(TINY, teacher=teacher), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nobody", "no policy 'nobody'"),
        ("oracle", "a policy that remembers"),
        ("revised", "a policy that remembers"),
        ("adaptive", "trained for"),
    ],
)
def test_whoever_cannot_be_gone_on_from_is_refused_before_anything_is_written(name, told, tmp_path):
    wrong = tmp_path / "PR2.safetensors"
    packaged("avrgym/ScratchItchPR2-v1", "adaptive").save(wrong)
    initial = str(wrong) if name == "adaptive" else name
    with pytest.raises(ValueError, match=told):
        train(replace(TINY, initial=initial), tmp_path / "out")
    with pytest.raises(ValueError, match="leave out the teacher"):
        train(replace(TINY, initial="adaptive", teacher="revised"), tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_it_goes_on_from_the_very_policy(tmp_path):
    """As long as only the critic learns, the policy stays as it was."""
    train(replace(TINY, steps=200, initial="adaptive"), tmp_path / "out")
    before, after = (
        packaged(TINY.environment, "adaptive"),
        Policy.load(tmp_path / "out" / "policy.safetensors"),
    )
    seen = np.random.default_rng(3).standard_normal((20, 2, before.observation_size))
    there, here = Actor(before, 2), Actor(after, 2)
    for each in seen:
        assert_allclose(here.mean(each), there.mean(each), atol=1e-6)
    assert after.metadata.curve[: len(before.metadata.curve)] == before.metadata.curve


def test_an_overload_costs_by_the_highest_share_of_a_limit(monkeypatch):
    environment, steps, seeds = "avrgym/FeedingPR2-v1", 40, [0, 1, 2]
    monkeypatch.setattr("avrgym.learning.rollouts.EPISODE_STEPS", steps)
    policy = packaged(environment, "revised")
    place = Place(environment, TransferredFile.of("participants"), "none", 1, "threads")
    orders = [Order(place, 0, np.array(seeds), overload_weight=weight) for weight in (0.0, 1.0, 3.0)]
    free, once, thrice = (roll_out(policy, order) for order in orders)
    assert free.observations.tobytes() == once.observations.tobytes()
    cost = free.rewards - once.rewards
    assert_allclose(free.rewards - thrice.rewards, 3.0 * cost, atol=1e-4)

    worlds = Episodes(environment, len(seeds), distribution="participants", by_region=True, num_threads=1)
    watch, actor = RegionWatch(len(seeds)), Actor(policy, len(seeds))
    seen = worlds.begin(np.arange(len(seeds)), [np.random.default_rng(seed) for seed in seeds])
    for _ in range(steps):
        action = np.clip(actor.mean(seen.astype(np.float32)), -1.0, 1.0).astype(np.float32)
        worlds.command(action)
        for _ in range(SUBSTEPS):
            worlds.simulation.step(1)
            watch.add(worlds.simulation.region_force_n())
        seen = worlds.evaluate_step(action).observation
    peak_share = (watch.loads().peak_n / TRANSIENT_LIMIT_N).max(axis=-1)
    assert peak_share.max() > 0.5
    assert_allclose(cost.max(axis=0), np.maximum(2.0 * peak_share - 1.0, 0.0), atol=1e-4)


def test_newtons_beyond_the_most_are_not_paid_for(monkeypatch):
    """Scratching pays 2 for each newton of a scratch and 0.01 for each at the itch."""
    environment, steps, seeds, most = TINY.environment, 60, np.arange(2), 3.0
    monkeypatch.setattr("avrgym.learning.rollouts.EPISODE_STEPS", steps)
    policy = packaged(environment, "revised")
    place = Place(environment, TransferredFile.of("revised"), "none", 1, "threads")
    free, held = (roll_out(policy, Order(place, 0, seeds, paid_force_n=each)) for each in (np.inf, most))
    worlds, actor = Episodes(environment, 2, distribution="revised", num_threads=1), Actor(policy, 2)
    seen, taken_off = worlds.begin(np.arange(2), [np.random.default_rng(seed) for seed in seeds]), []
    for _ in range(steps):
        action = np.clip(actor.mean(seen.astype(np.float32)), -1.0, 1.0).astype(np.float32)
        step = worlds.step(action)
        seen, terms = step.observation, step.reward_terms
        beyond = [np.maximum(terms[name] - most, 0.0) for name in ("scratch_force_n", "force_at_itch_n")]
        taken_off.append(2.0 * beyond[0] + 0.01 * beyond[1])
    assert np.max(taken_off) > 1.0
    assert_allclose(free.rewards - held.rewards, taken_off, atol=1e-4)


def test_a_folder_without_training_is_refused(tmp_path):
    with pytest.raises(ValueError, match="no training of an adaptive policy"):
        resume(tmp_path)


@pytest.mark.slow
def test_with_withdrawal_contact_after_success_earns_nothing_and_imitation_shows_waiting():
    place = Place("avrgym/FeedingJaco-v1", TransferredFile.of("revised"), "none", 1, "threads")
    order = Order(place, 0, np.array([3]), by_expert=np.array([True]))
    policy = packaged("avrgym/FeedingJaco-v1", "adaptive")
    goes_on = roll_out(policy, order)
    waits = roll_out(policy, replace(order, place=replace(place, withdraw_after_success=True)))
    assert goes_on.success.all()
    assert waits.success.all()
    assert (goes_on.rewards[-20:] != 0.0).all()
    assert np.abs(goes_on.actions[-20:]).max() > 0.0
    assert (waits.rewards[-20:] == 0.0).all()
    assert (waits.actions[-20:] == 0.0).all()


@pytest.mark.slow
def test_every_other_round_of_imitation_is_of_people_who_sit_still(tmp_path, monkeypatch):
    met: list[tuple[str, str]] = []

    def rolled_out(policy, order):
        met.append((order.place.people.name, order.place.impairment))
        return roll_out(policy, order)

    monkeypatch.setattr(adaptive, "roll_out", rolled_out)
    train(replace(TINY, steps=800, imitation_share=1.0), tmp_path / "training")
    assert met == [("zoo/train", "none"), ("revised", "none"), ("zoo/train", "limits"), ("revised", "none")]
