import itertools
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.policies import trained_policies
from avrgym.policies.registry import find_default_policy_name
from avrgym.policies.trained_policies import (
    Policy,
    PolicyError,
    PolicyMetadata,
    find_packaged_policies,
    find_policy_file,
    load_policy,
)
from avrgym.tasks.registry import ENVIRONMENTS

ENVIRONMENT = "avrgym/FeedingJaco-v1"
METADATA = PolicyMetadata(
    environment=ENVIRONMENT, people="revised", steps=10, seed=3, measured={"success_rate": 0.5, "note": "<b>"}
)


def make_policy(sizes=(25, 64, 64, 7), seed=0, deviation=0.3) -> Policy:
    rng = np.random.default_rng(seed)
    layers = list(itertools.pairwise(sizes))
    return Policy(
        weights=tuple(rng.standard_normal(layer) / np.sqrt(layer[0]) for layer in layers),
        biases=tuple(rng.standard_normal(outputs) / 4 for _, outputs in layers),
        observation_mean=rng.standard_normal(sizes[0]),
        observation_variance=rng.uniform(0, 2, sizes[0]),
        observation_clip=10.0,
        observation_epsilon=1e-8,
        action_std=deviation,
        metadata=METADATA,
    )


def saved(tmp_path: Path, policy: Policy | None = None) -> Path:
    path = tmp_path / "policy.safetensors"
    (policy or make_policy()).save(path)
    return path


def altered(path: Path, tensors: dict[str, np.ndarray | None], header: dict[str, str] | None = None) -> Path:
    """Rewrite a policy's file with some tensors changed, added, or (None) left out."""
    with safetensors.safe_open(path, framework="numpy") as file:
        header = file.metadata() if header is None else header
    new = {**safetensors.numpy.load_file(path), **tensors}
    safetensors.numpy.save_file(
        {name: array for name, array in new.items() if array is not None}, path, header
    )
    return path


def observations(count: int, size: int = 25) -> np.ndarray:
    return 3 * np.random.default_rng(1).standard_normal((count, size))


def generators(count: int) -> list[np.random.Generator]:
    return [np.random.default_rng(seed) for seed in range(count)]


# Acting


def test_a_policy_by_hand():
    policy = Policy(
        weights=(np.array([[1.0], [2.0]]), np.array([[4.0, -9.0]])),
        biases=(np.array([9.7]), np.array([0.1, 0.0])),
        observation_mean=np.array([1.0, 0.0]),
        observation_variance=np.array([3.0, 0.0]),
        observation_clip=5.0,
        observation_epsilon=1.0,
        action_std=0.25,
        metadata=METADATA,
    )
    hidden = np.tanh(0.5 * 1 - 5.0 * 2 + 9.7)
    assert_allclose(
        policy.compute_mean_actions(np.array([[2.0, -80.0]])), [[4 * hidden + 0.1, -9 * hidden]], rtol=1e-12
    )
    drawn = policy.compute_mean_actions(np.array([[2.0, -80.0]])) + 0.25 * np.random.default_rng(
        0
    ).standard_normal(2)
    acted = policy.act(np.array([[2.0, -80.0]]), generators(1))
    assert_allclose(acted, np.clip(drawn, -1.0, 1.0), rtol=1e-6)


@pytest.mark.parametrize("sizes", [(25, 64, 64, 7), (30, 5, 3, 7), (4, 1), (2, 33, 1)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.fast_cases(3)
def test_the_batch_size_does_not_change_the_bits_of_a_row(sizes, dtype):
    policy = make_policy(sizes)
    batch = observations(64, sizes[0]).astype(dtype)
    actions = policy.act(batch, generators(64))
    for row in range(64):
        assert_array_equal(
            policy.act(batch[row : row + 1], generators(64)[row : row + 1]), actions[row : row + 1]
        )
        assert_array_equal(policy.act(batch[: row + 1], generators(row + 1)), actions[: row + 1])
    assert_array_equal(policy.act(np.asfortranarray(batch), generators(64)), actions)
    assert_array_equal(policy.act(batch[::-1], generators(64)[::-1])[::-1], actions)


def test_actions_have_the_stated_standard_deviation():
    policy = make_policy((25, 8, 7), deviation=0.02)
    observation = 0.01 * observations(1)
    mean = policy.compute_mean_actions(observation)[0]
    random = generators(1)
    drawn = np.array([policy.act(observation, random)[0] for _ in range(2000)])
    inside = np.abs(mean) < 0.9
    assert inside.sum() > 2
    assert_allclose(drawn.mean(axis=0)[inside], mean[inside], atol=0.002)
    assert_allclose(drawn.std(axis=0)[inside], 0.02, rtol=0.1)


def test_a_policy_without_noise_draws_nothing():
    policy, random = make_policy(deviation=0.0), generators(4)
    actions = policy.act(observations(4), random)
    assert_array_equal(
        actions, np.clip(policy.compute_mean_actions(observations(4)), -1, 1).astype(np.float32)
    )
    assert [each.random() for each in random] == [each.random() for each in generators(4)]


def test_actions_are_float32_in_bounds_and_observations_unchanged():
    batch = observations(64) * 1e6
    before = batch.copy()
    actions = make_policy().act(batch, generators(64))
    assert actions.dtype == np.float32
    assert np.abs(actions).max() <= 1
    assert_array_equal(batch, before)
    assert make_policy().act(observations(0), []).shape == (0, 7)


@pytest.mark.parametrize("shape", [(25,), (1, 24), (1, 1, 25)])
def test_observations_of_another_shape_are_refused(shape):
    with pytest.raises(PolicyError, match=r"allowed: \(N, 25\)"):
        make_policy().act(np.zeros(shape), generators(shape[0]))


def test_every_observation_needs_a_generator():
    with pytest.raises(PolicyError, match="3 random generators for 4 observations"):
        make_policy().act(observations(4), generators(3))


def test_a_policy_cannot_be_changed():
    policy = make_policy()
    with pytest.raises(ValueError, match="read-only"):
        policy.weights[0][0, 0] = 1


# Files


def test_a_saved_policy_acts_with_the_same_bits(tmp_path):
    policy = make_policy()
    loaded = Policy.load(saved(tmp_path, policy))
    assert loaded.metadata == METADATA
    assert (loaded.observation_size, loaded.action_size) == (25, 7)
    assert_array_equal(
        loaded.act(observations(64), generators(64)), policy.act(observations(64), generators(64))
    )


def test_float32_tensors_are_read(tmp_path):
    path = saved(tmp_path)
    weight = make_policy().weights[0].astype(np.float32)
    assert_array_equal(Policy.load(altered(path, {"actor.0.weight": weight})).weights[0], weight)


def test_an_existing_file_is_replaced_only_with_overwrite(tmp_path):
    path = saved(tmp_path)
    before = path.read_bytes()
    with pytest.raises(PolicyError, match="already exists"):
        make_policy(seed=1).save(path)
    assert path.read_bytes() == before
    make_policy(seed=1).save(path, overwrite=True)
    assert path.read_bytes() != before


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = saved(tmp_path)
    before = path.read_bytes()

    def full_disk(_descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full_disk)
    with pytest.raises(OSError, match="No space"):
        make_policy(seed=1).save(path, overwrite=True)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


WRONG_TENSORS = {
    "a missing tensor": ({"actor.1.bias": None}, r"\['actor.1.bias'\] are missing"),
    "a foreign tensor": ({"critic.weight": np.zeros(1)}, "'critic.weight'.* are not allowed"),
    "layers that do not chain": ({"actor.1.weight": np.zeros((63, 64))}, "allowed: 64 × any"),
    "a bias of another size": ({"actor.0.bias": np.zeros(63)}, "allowed: 64"),
    "a vector for a matrix": ({"actor.0.weight": np.zeros(25)}, "allowed: 25 × any"),
    "a layer of size 0": (
        {"actor.2.weight": np.zeros((64, 0)), "actor.2.bias": np.zeros(0)},
        "allowed: 64 × any",
    ),
    "another observation": ({"observation.mean": np.zeros(24)}, "allowed: 24"),
    "a matrix for the mean": ({"observation.mean": np.zeros((25, 1))}, "allowed: any"),
    "several clips": ({"observation.clip": np.ones(2)}, "observation.clip has the shape .*allowed: 1"),
    "not a number": (
        {"actor.2.bias": np.full(7, np.nan)},
        "actor.2.bias contains NaN or infinity",
    ),
    "infinity": ({"observation.epsilon": np.array([np.inf])}, "contains NaN or infinity"),
    "a negative variance": ({"observation.variance": np.full(25, -1.0)}, "0 and above"),
    "a negative deviation": ({"action.deviation": np.array([-0.1])}, "0 and above"),
    "two deviations": ({"action.deviation": np.zeros(2)}, "action.deviation has the shape"),
    "an epsilon of 0": ({"observation.epsilon": np.zeros(1)}, "above 0"),
    "integers": ({"actor.2.bias": np.zeros(7, np.int64)}, "I64; allowed: F32 and F64"),
    "a foreign type": ({"actor.2.bias": np.zeros(7, np.float16)}, "F16; allowed"),
    "no layer at all": (
        {f"actor.{layer}.{part}": None for layer in range(3) for part in ("weight", "bias")},
        "0 weight matrices and 0 bias vectors",
    ),
}


@pytest.mark.parametrize(("tensors", "message"), WRONG_TENSORS.values(), ids=WRONG_TENSORS)
def test_wrong_tensors_are_refused(tmp_path, tensors, message):
    path = altered(saved(tmp_path), tensors)
    with pytest.raises(PolicyError, match=message) as error:
        Policy.load(path)
    assert str(path) in str(error.value)


WRONG_HEADERS = {
    "none": ({}, "not a policy of AVR Gym"),
    "foreign": ({"format": "pt"}, r"not a policy of AVR Gym.*\['format'\]"),
    "not JSON": ({"avrgym_policy": "{"}, "in the header is invalid"),
    "no version": ({"avrgym_policy": "{}"}, "format_version"),
    "another version": ({"avrgym_policy": '{"format_version": 1}'}, "format version 1; allowed: 2"),
    "fields missing": ({"avrgym_policy": '{"format_version": 2}'}, "missing required field"),
    "unknown fields": ({"avrgym_policy": '{"format_version": 2, "code": ""}'}, "unknown field `code`"),
}


@pytest.mark.parametrize(("header", "message"), WRONG_HEADERS.values(), ids=WRONG_HEADERS)
def test_wrong_headers_are_refused(tmp_path, header, message):
    with pytest.raises(PolicyError, match=message):
        Policy.load(altered(saved(tmp_path), {}, header))


FOREIGN_FILES = {
    "empty": b"",
    "text": b"original",
    "a pickle": pickle.dumps({"weights": [1.0] * 100}),
    "a huge header": b"\xff" * 64,
}


@pytest.mark.parametrize("content", FOREIGN_FILES.values(), ids=FOREIGN_FILES)
def test_foreign_files_are_refused(tmp_path, content):
    path = tmp_path / "foreign.safetensors"
    path.write_bytes(content)
    with pytest.raises(PolicyError, match=r"foreign.safetensors: not a readable .safetensors file"):
        Policy.load(path)


def test_a_truncated_file_is_refused_wherever_it_ends(tmp_path):
    content = saved(tmp_path).read_bytes()
    path = tmp_path / "truncated.safetensors"
    for end in (*range(0, 2000, 7), *range(2000, len(content), 997), len(content) - 1):
        path.write_bytes(content[:end])
        with pytest.raises(PolicyError, match="not a readable"):
            Policy.load(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    for path in (tmp_path, tmp_path / "none.safetensors"):
        with pytest.raises(PolicyError, match="not a readable"):
            Policy.load(path)


# Names


@pytest.fixture
def packaged(tmp_path, monkeypatch):
    monkeypatch.setattr(trained_policies, "PACKAGED_POLICY_FOLDER", tmp_path)
    for name in ("FeedingJaco-original", "FeedingJaco-revised", "FeedingPR2-original"):
        make_policy().save(tmp_path / f"{name}.safetensors")
    return tmp_path


def test_names_resolve_to_the_packaged_files(packaged):
    assert list(find_packaged_policies(ENVIRONMENT)) == ["original", "revised"]
    assert find_policy_file("revised", ENVIRONMENT) == packaged / "FeedingJaco-revised.safetensors"
    assert find_policy_file("original", "FeedingPR2-v1") == packaged / "FeedingPR2-original.safetensors"


def test_other_names_are_paths(packaged):
    path = packaged / "FeedingPR2-original.safetensors"
    assert find_policy_file(path, ENVIRONMENT) == path
    assert find_policy_file(str(path), ENVIRONMENT) == path


def test_unknown_names_list_what_is_allowed(packaged):
    with pytest.raises(
        PolicyError, match="'best' for avrgym/FeedingJaco-v1; allowed: original, revised, or the path"
    ):
        find_policy_file("best", ENVIRONMENT)
    with pytest.raises(PolicyError, match="no packaged policy"):
        find_policy_file("original", "avrgym/BedBathingJaco-v1")


def test_a_policy_for_other_sizes_is_refused(packaged):
    assert load_policy("original", ENVIRONMENT, 25, 7).action_size == 7
    with pytest.raises(
        PolicyError, match=r"with 25 observations and 7 actions; .* needs 30 observations and 7 actions"
    ):
        load_policy("original", ENVIRONMENT, 30, 7)


def test_a_policy_for_another_environment_is_refused_unless_that_is_allowed(packaged):
    """Also where all sizes are the same."""
    path, other = packaged / "FeedingPR2-original.safetensors", make_policy().metadata.environment
    assert other == ENVIRONMENT
    with pytest.raises(
        PolicyError, match=f"trained for {ENVIRONMENT}, not for avrgym/FeedingPR2-v1; allowed only"
    ):
        load_policy(path, "avrgym/FeedingPR2-v1", 25, 7)
    assert load_policy(path, "avrgym/FeedingPR2-v1", 25, 7, allow_other_environment=True).action_size == 7
    with pytest.raises(PolicyError, match=r"needs 30 observations and 7 actions"):
        load_policy(path, "avrgym/ScratchItchPR2-v1", 30, 7, allow_other_environment=True)


def test_numbers_whose_sums_overflow_are_refused():
    """Whatever is observed, what a policy does is finite."""
    sound = make_policy()
    for layer in range(len(sound.weights)):
        weights = [np.full_like(w, 1e308) if i == layer else w for i, w in enumerate(sound.weights)]
        with pytest.raises(PolicyError, match=rf"sums of the layer actor\.{layer} can overflow"):
            replace(sound, weights=tuple(weights))
    large = replace(sound, weights=tuple(np.full_like(weight, 1e300) for weight in sound.weights))
    for seen in (0.0, 1e9, -1e300):
        observations = np.full((2, sound.observation_size), seen)
        assert np.isfinite(large.act(observations, [np.random.default_rng(i) for i in range(2)])).all()


@pytest.mark.parametrize(
    "path", sorted(trained_policies.PACKAGED_POLICY_FOLDER.glob("*.safetensors")), ids=lambda path: path.stem
)
def test_packaged_policies_name_environment_and_people(path):
    scene, kind = path.stem.split("-")
    assert find_policy_file(kind, f"avrgym/{scene}-v1") == path
    assert path.stat().st_size < 500_000
    metadata = Policy.load(path).metadata
    people = "zoo/train" if kind == "adaptive" else kind
    assert (metadata.environment, metadata.people) == (f"avrgym/{scene}-v1", people)
    assert metadata.steps > 0
    assert int(metadata.measured["episodes"]) >= 200


def test_the_preferred_policy_is_adaptive_then_revised_then_oracle():
    for environment in ENVIRONMENTS:
        packaged = find_packaged_policies(environment)
        expected = [name for name in ("adaptive", "revised") if name in packaged]
        assert find_default_policy_name(environment) == [*expected, "oracle"][0]


def test_arrays_of_wrong_shapes_are_refused():
    with pytest.raises(PolicyError, match="2 weight matrices and 3 bias vectors"):
        replace(make_policy(), weights=make_policy().weights[:2])
