"""Fitted models: published results, textbook formulas, and data that do not identify a model."""

import numpy as np
import pytest
from scipy import stats

from avrgym.analysis.models.estimate import EffectEstimate, ModelFitError
from avrgym.analysis.models.mixed_models import fit_mixed_model
from avrgym.analysis.models.ordinal_models import (
    KAUERMANN_CARROLL_CORRECTION,
    MANCL_DEROUEN_CORRECTION,
    NO_LEVERAGE_CORRECTION,
    compute_clustered_covariance,
    fit_ordinal_model,
)
from helpers.studies.published_data import RESPIRATION, SLEEP, WINE

DAYS = np.tile(np.arange(10.0), 18)
SLEEPER = np.repeat(np.arange(18), 10)


# Published figures


def test_sleep_is_modelled_as_by_lme4() -> None:
    """``lmer(Reaction ~ Days + (Days || Subject))`` and ``(1 | Subject)``: Bates et al., J. Stat. Softw. 67, 2015."""
    design = np.stack([np.ones(180), DAYS], axis=1)
    found = fit_mixed_model(SLEEP.ravel(), design, SLEEPER, [SLEEPER, DAYS[:, None]])
    assert found.variance_components == pytest.approx([627.57, 35.86, 653.58], abs=0.006)
    assert found.coefficients == pytest.approx([251.405, 10.467], abs=6e-4)
    assert np.sqrt(np.diag(found.coefficient_covariance)) == pytest.approx([6.885, 1.560], abs=6e-4)
    found = fit_mixed_model(SLEEP.ravel(), design, SLEEPER, [SLEEPER])
    assert found.variance_components == pytest.approx([1378.2, 960.5], abs=0.06)
    estimate = found.estimate(np.array([0.0, 1.0]))
    assert (estimate.value, estimate.standard_error) == (
        pytest.approx(10.4673, abs=6e-5),
        pytest.approx(0.8042, abs=6e-5),
    )
    assert estimate.df == pytest.approx(161)


def test_wine_is_modelled_as_by_ordinal() -> None:
    """``clm(rating ~ temp + contact)``: Christensen, vignette of R's ordinal."""
    bottle = np.tile(np.arange(8), 9)
    design = np.stack([bottle < 4, bottle % 4 < 2], axis=1) == 0
    found = fit_ordinal_model(WINE.ravel(), design.astype(float), np.repeat(np.arange(9), 8))
    assert found.coefficients == pytest.approx([2.503, 1.528], abs=6e-4)
    assert found.category_thresholds == pytest.approx([-1.344, 1.251, 3.467, 5.006], abs=6e-4)


def test_respiration_is_modelled_as_by_gee() -> None:
    """``gee(status ~ …, corstr = "independence")``: Hothorn and Everitt, A Handbook of Statistical Analyses Using R."""
    status = np.array([[int(visit) for visit in patient[-4:]] for patient in RESPIRATION])
    known = [
        (patient[0] == "2", patient[1] == "A", patient[2] == "M", patient[-5] == "1", float(patient[3:-6]))
        for patient in RESPIRATION
    ]
    design, patients = np.repeat(np.array(known, float), 4, axis=0), np.repeat(np.arange(111), 4)
    found = fit_ordinal_model(status.ravel(), design, patients, NO_LEVERAGE_CORRECTION)
    assert found.coefficients == pytest.approx(
        [0.67160098, 1.29921589, 0.11924365, 1.88202860, -0.01816588], abs=1e-6
    )
    assert np.sqrt(np.diag(found.coefficient_covariance)) == pytest.approx(
        [0.35681913, 0.35077797, 0.44320235, 0.35005152, 0.01300426], abs=1e-6
    )


# Formulas


def test_corrected_covariances_are_those_of_their_definitions(rng: np.random.Generator) -> None:
    """Logistic regression written out: residuals divided by I − H, or by its root, for each cluster."""
    design = np.hstack([np.ones((24, 1)), rng.normal(size=(24, 2))])
    shares = rng.uniform(0.2, 0.8, 24)
    residuals = rng.normal(size=24)
    spread = shares * (1 - shares)
    clusters = np.arange(24).reshape(6, 4)
    bread = np.linalg.inv(design.T @ (spread[:, None] * design))
    scores = np.array([design[own].T @ residuals[own] for own in clusters])
    information = np.array([design[own].T @ (spread[own][:, None] * design[own]) for own in clusters])
    for power in (NO_LEVERAGE_CORRECTION, KAUERMANN_CARROLL_CORRECTION, MANCL_DEROUEN_CORRECTION):
        meat = np.zeros((3, 3))
        for own in clusters:
            root = np.sqrt(spread[own])
            hat = root[:, None] * (design[own] @ bread @ design[own].T) * root
            values, axes = np.linalg.eigh(np.eye(4) - hat)
            larger = root * (axes @ (values**-power * (axes.T @ (residuals[own] / root))))
            score = design[own].T @ larger
            meat += np.outer(score, score)
        expected = bread @ meat @ bread
        assert compute_clustered_covariance(scores, information, power) == pytest.approx(expected, rel=1e-9)


def test_the_order_of_answers_does_not_matter_to_their_size(rng: np.random.Generator) -> None:
    """Turned around, effects change sign; other numbers for the same categories change nothing."""
    design, people = rng.normal(size=(60, 2)), np.repeat(np.arange(10), 6)
    answers = rng.integers(1, 6, 60)
    found, turned = fit_ordinal_model(answers, design, people), fit_ordinal_model(-answers, design, people)
    assert turned.coefficients == pytest.approx(-found.coefficients, abs=1e-8)
    assert turned.coefficient_covariance == pytest.approx(found.coefficient_covariance, rel=1e-6)
    assert fit_ordinal_model(answers**3, design, people).coefficients == pytest.approx(
        found.coefficients, abs=1e-12
    )


@pytest.mark.parametrize("differ", [0.0, 2.0])
def test_balanced_pairs_are_tested_as_by_student(differ: float, rng: np.random.Generator) -> None:
    """With as many values of each participant in two conditions it is the t test of their means' differences.

    Also if participants differ less between conditions than expected by chance.
    """
    values = rng.normal(size=(9, 2, 4)) + rng.normal(size=(9, 1, 1)) + differ * rng.normal(size=(9, 2, 1))
    people = np.repeat(np.arange(9), 8)
    condition = np.tile(np.repeat([0, 1], 4), 9)
    design = np.stack([np.ones(72), condition], axis=1)
    found = fit_mixed_model(values.ravel(), design, people, [people, condition]).estimate(
        np.array([0.0, 1.0])
    )
    means = values.mean(axis=2)
    expected = stats.ttest_rel(means[:, 1], means[:, 0])
    interval = expected.confidence_interval()
    assert (found.p, found.df) == (pytest.approx(expected.pvalue, rel=1e-6), pytest.approx(8, rel=1e-6))
    assert (found.ci_low, found.ci_high) == pytest.approx((interval.low, interval.high), rel=1e-6)


# What data cannot tell

PEOPLE = np.repeat(np.arange(6), 4)
CONDITION = np.tile([0.0, 0.0, 1.0, 1.0], 6)[:, None]
WITH_CONSTANT = np.hstack([np.ones((24, 1)), CONDITION])


def test_separated_groups_have_no_odds_ratio(rng: np.random.Generator) -> None:
    always = np.where(CONDITION[:, 0] == 1, 1, rng.integers(0, 2, 24))
    for values in (CONDITION[:, 0], always, 1 - always):
        with pytest.raises(ModelFitError, match="complete separation"):
            fit_ordinal_model(values, CONDITION, PEOPLE)


def test_equal_values_are_no_data() -> None:
    with pytest.raises(ModelFitError, match="all values are equal"):
        fit_ordinal_model(np.ones(24), CONDITION, PEOPLE)
    with pytest.raises(ModelFitError, match="all values are equal"):
        fit_mixed_model(np.ones(24), WITH_CONSTANT, PEOPLE, [PEOPLE])


def test_effects_that_are_the_same_cannot_be_told_apart(rng: np.random.Generator) -> None:
    values, twice = rng.integers(0, 3, 24), np.hstack([CONDITION, CONDITION])
    with pytest.raises(ModelFitError):
        fit_ordinal_model(values, twice, PEOPLE).estimate(np.array([1.0, 0.0]))
    with pytest.raises(ModelFitError, match="identifiable"):
        fit_mixed_model(values, np.hstack([WITH_CONSTANT, CONDITION]), PEOPLE, [PEOPLE])


def test_differences_that_are_all_the_same_have_no_variance(rng: np.random.Generator) -> None:
    values = np.repeat(rng.normal(size=6), 4) + CONDITION[:, 0]
    with pytest.raises(ModelFitError):
        fit_mixed_model(values, WITH_CONSTANT, PEOPLE, [PEOPLE]).estimate(np.array([0.0, 1.0]))
    with pytest.raises(ModelFitError, match="variance is zero"):
        EffectEstimate.from_variance(1.0, 0.0, 3.0)


def test_one_cluster_that_alone_determines_an_effect_is_told(rng: np.random.Generator) -> None:
    values, only = rng.integers(0, 3, 24), (PEOPLE == 2).astype(float)[:, None]
    with pytest.raises(ModelFitError, match="one participant alone"):
        fit_ordinal_model(values, only, PEOPLE)
