"""Reward weights that are fitted to ratings of trials."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.analysis.reward_model import (
    RatedTrial,
    find_preference_pairs,
    fit_reward_model,
    fit_reward_models,
    fit_reward_weights,
    write_reward_models,
)
from avrgym.cli.main import app
from avrgym.learning.preference_reward import read_preference_weights
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import enrol_included, run_trials
from helpers.studies.small_studies import make_study

TERMS = ("force_on_person_n", "tool_speed_m_s", "distance_m")
WEIGHTS = np.array([-0.5, -4.0, 0.0])
SIZES = np.array([2.0, 0.3, 0.5])


def trials(participants: int, each: int, noise: float, seed: int = 0) -> list[RatedTrial]:
    """Trials with random terms. Ratings follow the weights, with an offset for each participant."""
    random = np.random.default_rng(seed)
    found: list[RatedTrial] = []
    for participant in range(participants):
        offset = random.normal(0.0, 3.0)
        for _ in range(each):
            values = random.exponential(SIZES)
            rating = float(np.round(offset + values @ WEIGHTS + random.normal(0.0, noise), 1))
            terms: dict[str, float] = dict(zip(TERMS, values.tolist(), strict=True))
            found.append(RatedTrial(f"sub-{participant:03}", "FeedingJaco", rating, terms, -values[2]))
    return found


def test_weights_and_accuracy_follow_the_ratings() -> None:
    model = fit_reward_model("FeedingJaco", trials(12, 6, noise=0.2), simulated=True)
    assert model is not None
    assert model.accuracy > 0.9
    assert abs(model.accuracy_of_reward - 0.5) < 0.1
    found = np.array([model.weights[name] for name in TERMS])
    assert found[1] / found[0] == pytest.approx(WEIGHTS[1] / WEIGHTS[0], rel=0.3)
    assert abs(found[2] * SIZES[2]) < 0.2 * abs(found[0] * SIZES[0])


def test_random_ratings_are_predicted_by_chance_only() -> None:
    accuracies = []
    for seed in range(20):
        model = fit_reward_model("FeedingJaco", trials(8, 4, noise=1000.0, seed=seed), simulated=True)
        assert model is not None
        accuracies.append(model.accuracy)
    assert abs(np.mean(accuracies) - 0.5) < 0.06


def test_comparisons_are_of_one_participant_and_omit_ties() -> None:
    own = [RatedTrial("sub-001", "FeedingJaco", rating, {}, 0.0) for rating in (3.0, 5.0, 5.0)]
    other = RatedTrial("sub-002", "FeedingJaco", 9.0, {}, 0.0)
    assert [(better.rating, worse.rating) for better, worse in find_preference_pairs([*own, other])] == [
        (5.0, 3.0)
    ] * 2


def test_weights_are_the_maximum_of_the_penalised_likelihood() -> None:
    differences = np.random.default_rng(1).normal(0.5, 1.0, (40, 3))

    def loss(weights: np.ndarray) -> float:
        return float(np.logaddexp(0.0, -differences @ weights).sum() + 0.5 * weights @ weights)

    weights = fit_reward_weights(differences)
    for change in np.random.default_rng(2).normal(0.0, 0.01, (20, 3)):
        assert loss(weights) < loss(weights + change)


def test_a_study_without_comparisons_is_refused(tmp_path: Path) -> None:
    with (
        StudyStore(make_study(tmp_path / "study")) as store,
        pytest.raises(StudyError, match="no task has comparisons of at least 3 participants"),
    ):
        fit_reward_models(store)
    (tmp_path / "reward.json").write_text("")
    with pytest.raises(FileExistsError, match="already exists"):
        write_reward_models([], tmp_path / "reward.json")


@pytest.mark.slow
def test_a_study_with_comparisons_yields_a_file(tmp_path: Path) -> None:
    study = make_study(tmp_path / "study")
    with StudyStore(study) as store:
        for _ in range(3):
            run_trials(store, enrol_included(store))
    out = tmp_path / "reward.json"
    run = CliRunner().invoke(app, ["fit-reward", str(study), "--out", str(out)])
    assert run.exit_code == 0, run.output
    for model in json.loads(out.read_text()):
        assert set(model["weights"]) == {"distance_m", "action_squared", "force_on_person_n"}
        assert (model["participants"], model["simulated"]) == (3, True)
        assert 0.0 <= model["accuracy"] <= 1.0
        assert read_preference_weights(out, f"avrgym/{model['task']}Jaco-v1") == model["weights"]
