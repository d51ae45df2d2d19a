"""Policies with memory: laws of batches, episodes and files."""

from dataclasses import replace

import numpy as np
import pytest
import safetensors.numpy
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.networks.layers import GatedRecurrentUnit
from avrgym.policies import registry
from avrgym.policies.actors import Actor
from avrgym.policies.trained_policies import Policy, PolicyError, PolicyMetadata, load_policy
from avrgym.tasks.episodes import Episodes

ENVIRONMENT = "avrgym/FeedingJaco-v1"
SEEN, UNITS, ACTION = 25, 16, 7


def make_policy(deviation=0.2) -> Policy:
    draw = np.random.default_rng(0).normal
    return Policy(
        weights=(draw(0, 0.2, (SEEN + UNITS, 8)), draw(0, 0.2, (8, ACTION))),
        biases=(draw(0, 0.2, 8), draw(0, 0.2, ACTION)),
        observation_mean=np.zeros(SEEN),
        observation_variance=np.ones(SEEN),
        observation_clip=10.0,
        observation_epsilon=1e-8,
        action_std=deviation,
        metadata=PolicyMetadata(environment=ENVIRONMENT, people="zoo/train", steps=1, seed=0),
        memory=GatedRecurrentUnit(
            draw(0, 0.3, (SEEN, 3 * UNITS)),
            draw(0, 0.3, 3 * UNITS),
            draw(0, 0.3, (UNITS, 3 * UNITS)),
            draw(0, 0.3, 3 * UNITS),
        ),
    )


def seen(steps: int, worlds: int) -> np.ndarray:
    return np.random.default_rng(1).standard_normal((steps, worlds, SEEN))


def acted(actor: Actor, observations: np.ndarray) -> np.ndarray:
    generators = [np.random.default_rng(each) for each in range(observations.shape[1])]
    return np.stack([actor.act(each, generators) for each in observations])


def test_earlier_observations_change_the_actions():
    observations = seen(2, 1)
    later = Actor(make_policy(0.0), 1)
    later.compute_mean_actions(observations[0])
    assert (
        np.abs(
            later.compute_mean_actions(observations[1])
            - Actor(make_policy(), 1).compute_mean_actions(observations[1])
        ).max()
        > 1e-3
    )


def test_a_batch_gives_each_world_the_same_actions_as_alone():
    observations = seen(5, 6)
    together = acted(Actor(make_policy(0.0), 6), observations)
    for world in range(6):
        alone = acted(Actor(make_policy(0.0), 1), observations[:, world : world + 1])
        assert_array_equal(alone[:, 0], together[:, world])


@pytest.mark.parametrize("forgotten", [[1], np.array([False, True, False])], ids=["numbers", "mask"])
def test_a_reset_clears_one_world_and_no_other(forgotten):
    before, after = seen(4, 3), seen(9, 3)[4:]
    actor, undisturbed = (Actor(make_policy(0.0), 3) for _ in range(2))
    acted(actor, before)
    actor.reset(forgotten)
    episode = acted(actor, after)
    assert_array_equal(episode[:, 1], acted(Actor(make_policy(0.0), 3), after)[:, 1])
    going_on = acted(undisturbed, np.concatenate([before, after]))[4:]
    assert_array_equal(episode[:, [0, 2]], going_on[:, [0, 2]])


def test_a_refused_observation_does_not_change_the_memory():
    actor = Actor(make_policy(), 1)
    for wrong in (np.zeros((2, SEEN)), np.zeros((1, SEEN + 1))):
        with pytest.raises(PolicyError, match="observations"):
            actor.compute_mean_actions(wrong)
    assert_array_equal(
        actor.compute_mean_actions(seen(1, 1)[0]), Actor(make_policy(), 1).compute_mean_actions(seen(1, 1)[0])
    )


def test_each_episode_starts_without_memory():
    world = Episodes(ENVIRONMENT, 1, num_threads=1)
    episodes = []
    for _ in range(2):
        generators = [np.random.default_rng(5)]
        observation = world.reset(np.array([0]), generators)
        actions = []
        with registry.open_policy(make_policy(), world, generators) as act:
            for _ in range(5):
                actions.append(act(observation))
                observation = world.step(actions[-1].astype(float)).observation
        episodes.append(actions)
    assert_array_equal(*episodes)


def test_files_contain_the_memory(tmp_path):
    path, policy = tmp_path / "remembers.safetensors", make_policy()
    policy.save(path)
    found = load_policy(path, ENVIRONMENT, SEEN, ACTION)
    assert_array_equal(acted(Actor(found, 3), seen(3, 3)), acted(Actor(policy, 3), seen(3, 3)))


@pytest.mark.parametrize("part", ["input_weight", "input_bias", "hidden_weight", "hidden_bias"])
def test_a_memory_of_another_size_is_refused(tmp_path, part):
    path = tmp_path / "wrong.safetensors"
    make_policy().save(path)
    with safetensors.safe_open(path, framework="numpy") as file:
        header = file.metadata()
    tensors = safetensors.numpy.load_file(path)
    tensors[f"memory.{part}"] = tensors[f"memory.{part}"][..., :-1].copy()
    safetensors.numpy.save_file(tensors, path, header)
    with pytest.raises(PolicyError, match=r"memory\.\w+ has the shape .*; allowed: ") as refusal:
        Policy.load(path)
    assert "\n" not in str(refusal.value)


def test_mean_refuses_a_recurrent_policy():
    with pytest.raises(PolicyError, match="recurrent"):
        make_policy().compute_mean_actions(np.zeros((1, SEEN)))
    onnx_export = pytest.importorskip("avrgym.policies.onnx", reason="ONNX is an extra")
    with pytest.raises(PolicyError, match="ONNX"):
        onnx_export.make_onnx_model(make_policy())


def test_numbers_too_large_are_refused():
    policy = make_policy()
    assert policy.memory is not None
    with pytest.raises(PolicyError, match="memory"):
        replace(policy, memory=replace(policy.memory, hidden_weight=np.full((UNITS, 3 * UNITS), 1e308)))


def test_without_memory_the_actor_equals_the_policy():
    policy = replace(make_policy(), memory=None, weights=(np.ones((SEEN, 8)), np.ones((8, ACTION))))
    assert_allclose(
        Actor(policy, 3).compute_mean_actions(seen(1, 3)[0]),
        policy.compute_mean_actions(seen(1, 3)[0]),
        rtol=0,
        atol=0,
    )
