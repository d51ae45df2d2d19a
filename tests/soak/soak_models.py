"""False positive rates of models in 1000 simulated studies of each kind: `make soak`."""

from collections import Counter
from collections.abc import Callable

import pytest

from avrgym.analysis.models.effects import (
    EFFECT_KINDS,
    TrialValue,
    list_effects_of_interest,
    make_design_matrix,
)
from avrgym.analysis.models.estimate import ModelFitError
from avrgym.analysis.models.fitting import (
    LOGISTIC_MODEL,
    MIXED_MODEL,
    ORDINAL_MODEL,
    drop_constant_groups,
    estimate_effects,
)
from avrgym.analysis.models.ordinal_models import (
    MANCL_DEROUEN_CORRECTION,
    NO_LEVERAGE_CORRECTION,
    fit_ordinal_model,
)
from avrgym.analysis.power.power_simulation import count_significant_studies
from avrgym.analysis.power.simulated_studies import PowerAssumptions
from avrgym.study.design.design import Design, parse_design, read_default_design_text
from helpers.studies.simulated_results import simulated_answers, simulated_rewards, simulated_successes

DESIGN = parse_design(read_default_design_text())
STUDIES = 1000
PARTICIPANTS = (4, 8, 16)
Simulate = Callable[[Design, int, int], list[TrialValue]]


def no_drift(design: Design, participants: int, number: int) -> list[TrialValue]:
    return simulated_answers(design, participants, number, drift=0.0)


KINDS = {ORDINAL_MODEL: no_drift, LOGISTIC_MODEL: simulated_successes, MIXED_MODEL: simulated_rewards}


@pytest.mark.parametrize("participants", PARTICIPANTS)
@pytest.mark.parametrize("model", KINDS)
def test_false_positives_are_about_five_percent(model: str, participants: int) -> None:
    """Random effects of participants, also by policy, robot and task; no effect of policies."""
    wanted, imagine = list_effects_of_interest(DESIGN), KINDS[model]
    hits: Counter[str] = Counter()
    fitted: Counter[str] = Counter()
    for number in range(STUDIES):
        for effect, found in estimate_effects(
            DESIGN, model, imagine(DESIGN, participants, number), wanted
        ).items():
            if not isinstance(found, ModelFitError):
                fitted[effect.kind] += 1
                hits[effect.kind] += found.p < 0.05
    shares = {kind: 100 * hits[kind] / fitted[kind] for kind in EFFECT_KINDS}
    told = ", ".join(f"{kind} {share:.1f} %" for kind, share in shares.items())
    print(f"\n{model}, {participants} participants, {fitted['policies']} of {STUDIES} fitted: {told}")
    assert fitted["policies"] > 0.8 * STUDIES
    assert all(share < 7.5 for share in shares.values())
    if participants == 8:
        assert 3.0 < shares["policies"] < 7.0


@pytest.mark.parametrize("participants", PARTICIPANTS)
def test_false_positives_of_other_tests(participants: int) -> None:
    """The paper's tests by trial and the uncorrected covariance are anticonservative, the others conservative."""
    counted = count_significant_studies(
        DESIGN, PowerAssumptions(dropout=0.0, drift=0.0), 0.0, participants, 0, range(STUDIES)
    )
    for (test, _), (hits, _) in counted.items():
        print(f"\n{test}, {participants} participants: {100 * hits / STUDIES:.1f} %")
    policies = list_effects_of_interest(DESIGN)[0]
    for name, correction in (
        ("uncorrected", NO_LEVERAGE_CORRECTION),
        ("Mancl and DeRouen", MANCL_DEROUEN_CORRECTION),
    ):
        hits = 0
        for number in range(STUDIES):
            observed, _ = drop_constant_groups(ORDINAL_MODEL, no_drift(DESIGN, participants, number))
            given = make_design_matrix(DESIGN, observed)
            people = [each.participant for each in observed]
            fitted = fit_ordinal_model([each.value for each in observed], given.matrix, people, correction)
            hits += fitted.estimate(given.make_contrast(policies)).p < 0.05
        print(f"ordinal, {name}, {participants} participants: {100 * hits / STUDIES:.1f} %")
    by_trial = next(hits for (test, _), (hits, _) in counted.items() if test == "policies, by trial")
    assert by_trial > 0.1 * STUDIES
