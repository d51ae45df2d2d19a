"""Evaluation: results depend only on the seed; intervals of proportions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from avrgym.learning import evaluation
from avrgym.learning.evaluation import EvaluationResult, compute_wilson_interval, evaluate, evaluate_all
from avrgym.policies.trained_policies import find_packaged_policies
from avrgym.safety.limits import BODY_REGIONS
from avrgym.tasks.constants import EPISODE_STEPS
from helpers.vr.visit import ENVIRONMENT, constant_policy

SCRATCHING = "avrgym/ScratchItchJaco-v1"


@pytest.fixture
def rewards(monkeypatch: pytest.MonkeyPatch) -> Callable[..., np.ndarray]:
    """Evaluates; gives the reward of every episode."""
    run, batches = evaluation._run, []

    def noted(*arguments):
        results = run(*arguments)
        batches.append(results[0])
        return results

    def episodes(count: int, *, at_once: int = 64, policy: str = "random", seed: int = 0) -> np.ndarray:
        batches.clear()
        monkeypatch.setattr(evaluation, "MAX_WORLDS_PER_BATCH", at_once)
        figures = evaluate(ENVIRONMENT, policy, "revised", count, seed)
        found = np.concatenate(batches)
        assert figures.reward_mean == pytest.approx(found.mean())
        assert figures.reward_std == pytest.approx(found.std())
        return found

    monkeypatch.setattr(evaluation, "_run", noted)
    return episodes


@pytest.mark.slow
def test_an_episode_does_not_depend_on_the_number_of_episodes(rewards: Callable[..., np.ndarray]) -> None:
    """Its results depend on seed and number only."""
    three = rewards(3)
    assert len(set(three)) == 3
    assert np.array_equal(rewards(1), three[:1])
    for at_once in (1, 2):
        assert np.array_equal(rewards(3, at_once=at_once), three)
    assert not np.intersect1d(rewards(3, seed=1), three).size


def test_batches_contain_each_episode_once_and_have_similar_sizes() -> None:
    for episodes, size in ((1, 64), (3, 2), (100, 64), (1000, 64)):
        batches = evaluation._parts(episodes, size)
        assert [number for batch in batches for number in batch] == list(range(episodes))
        sizes = {len(batch) for batch in batches}
        assert max(sizes) <= size
        assert max(sizes) - min(sizes) <= 1


@pytest.mark.slow
def test_a_policy_file_gives_the_results_of_its_name(rewards: Callable[..., np.ndarray]) -> None:
    path = find_packaged_policies(ENVIRONMENT)["revised"]
    assert np.array_equal(rewards(2, policy=str(path)), rewards(2, policy="revised"))


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["zero", "random"])
def test_the_same_seed_gives_the_same_results(policy: str) -> None:
    one, same = (evaluate(ENVIRONMENT, policy, "original", 3, 4) for _ in range(2))
    assert one == same
    assert (one.env, one.policy, one.people, one.episodes) == (ENVIRONMENT, policy, "original", 3)


def test_the_zero_policy_never_succeeds_and_touches_nobody() -> None:
    figures = evaluate(ENVIRONMENT, "zero", "original", 4, 0)
    assert figures.success_rate == 0.0
    assert figures.success_ci95 == compute_wilson_interval(0, 4)
    assert figures.force_mean_newton == 0.0
    assert figures.reward_mean < 0.0
    assert figures.episodes_over_limit == 0
    assert figures.guard_interventions is None
    assert {name: each.quasi_static_limit_n for name, each in figures.force_regions.items()} == {
        region.name: region.quasi_static_limit_n for region in BODY_REGIONS
    }
    assert all(each.peak_n == each.contact_share == 0.0 for each in figures.force_regions.values())


@pytest.mark.slow
@pytest.mark.parametrize("force_guard", [False, True])
def test_forces_by_region_do_not_depend_on_other_episodes(
    monkeypatch: pytest.MonkeyPatch, force_guard: bool
) -> None:
    rows: list[list[EvaluationResult]] = []
    for at_once in (2, 4):
        monkeypatch.setattr(evaluation, "MAX_WORLDS_PER_BATCH", at_once)
        asked = [SCRATCHING], "original", "participants", 4, 6
        rows.append(evaluate_all(*asked, jobs=1, force_guard=force_guard))
    assert rows[0] == rows[1]
    (found,) = rows[0]
    regions = found.force_regions.values()
    assert sum(each.mean_n for each in regions) > 1.0
    assert found.episodes_over_limit <= sum(each.exceedances for each in regions)
    assert all(each.mean_n <= each.peak_n and each.contact_share <= 1.0 for each in regions)
    assert (found.guard_interventions is not None) == force_guard


def test_progress_counts_environment_steps() -> None:
    steps: list[int] = []
    evaluate(ENVIRONMENT, "zero", "original", 2, 0, steps.append)
    assert sum(steps) == 2 * EPISODE_STEPS


def test_errors_name_what_is_allowed(tmp_path: Path) -> None:
    file = tmp_path / "drive.safetensors"
    constant_policy(ENVIRONMENT).save(file)
    with pytest.raises(ValueError, match="allowed: 1 or more"):
        evaluate(ENVIRONMENT, "zero", "original", 0, 0)
    with pytest.raises(ValueError, match=ENVIRONMENT):
        evaluate("avrgym/Nope-v1", "zero", "original", 1, 0)
    with pytest.raises(ValueError, match="original, revised"):
        evaluate(ENVIRONMENT, "zero", "martians", 1, 0)
    with pytest.raises(ValueError, match=r"original, revised, oracle, random, zero, FILE\.safetensors, "):
        evaluate(ENVIRONMENT, "nope", "original", 1, 0)


@pytest.mark.parametrize(
    ("successes", "count", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_the_interval_has_published_values(successes: int, count: int, low: float, high: float) -> None:
    """Newcombe, Statistics in Medicine 17, 1998, table I, method 3."""
    assert compute_wilson_interval(successes, count) == pytest.approx((low, high), abs=5e-5)


def test_the_interval_contains_the_proportion_and_is_symmetric() -> None:
    for count in (1, 7, 100):
        for successes in range(count + 1):
            low, high = compute_wilson_interval(successes, count)
            assert 0.0 <= low <= successes / count <= high <= 1.0
            assert (1.0 - high, 1.0 - low) == pytest.approx(compute_wilson_interval(count - successes, count))
