"""Models of all that the trials of a study give, with participants as clusters, beside the paper's tests."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from math import exp

from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.reading.observations import Observations
from avrgym.analysis.statistics.models.effects import EFFECTS, Effect, Observed, effects
from avrgym.analysis.statistics.models.fitted import Estimate, NoFit
from avrgym.analysis.statistics.models.fitting import MIXED, Found, estimates, informative
from avrgym.analysis.statistics.models.quantities import Source, observed_values, sources
from avrgym.analysis.statistics.tests import holm
from avrgym.study.design.design import Design
from avrgym.study.plan.plan import CONFIRMATORY, EXPLORATORY, Plan


def model_rows(design: Design, seen: Observations, plan: Plan | None = None) -> list[ModelRow]:
    """Every effect of every quantity, people and simulated participants apart; those of a plan are confirmatory."""
    rows: list[ModelRow] = []
    for simulated in sorted({row.simulated for row in seen.trials if row.counted}):
        for source in sources(design):
            rows += source_rows(design, source, simulated, observed_values(design, seen, simulated, source))
    return [replace(row, planned=_label(plan, row)) for row in rows]


def source_rows(
    design: Design, source: Source, simulated: bool, values: Mapping[str, Sequence[Observed]]
) -> list[ModelRow]:
    """The effects of a source's quantities, by kind; those of a kind are corrected together."""
    found = [row for each in values.items() for row in _rows(design, source, simulated, *each)]
    rows: list[ModelRow] = []
    for kind in EFFECTS:
        own = [row for row in found if row.effect == kind]
        adjusted = holm([row.p for row in own])
        rows += [replace(row, p_holm=p) for row, p in zip(own, adjusted, strict=True)]
    return rows


def _rows(
    design: Design, source: Source, simulated: bool, quantity: str, observed: Sequence[Observed]
) -> Iterator[ModelRow]:
    """All effects in the model of one quantity."""
    model, wanted = source.models[quantity], effects(design)
    kept, left_out = informative(model, observed)
    found, without = estimates(design, model, observed, wanted), _without_one(design, model, observed, wanted)
    for effect in wanted:
        estimate = found[effect]
        row = ModelRow(
            simulated=simulated,
            family=source.family(effect.kind),
            quantity=quantity,
            model=model,
            effect=effect.kind,
            group_a=effect.group_a,
            group_b=effect.group_b,
            participants=len({each.participant for each in kept}),
            values=len(kept),
            note=left_out,
        )
        if isinstance(estimate, NoFit):
            yield replace(row, note="; ".join(filter(None, (str(estimate), left_out))))
        else:
            yield _robust(_estimated(row, estimate), [each[effect] for each in without])


def _without_one(
    design: Design, model: str, observed: Sequence[Observed], wanted: Sequence[Effect]
) -> list[Found]:
    """The effects in models without each participant in turn."""
    people = dict.fromkeys(each.participant for each in observed)
    return [
        estimates(design, model, [each for each in observed if each.participant != who], wanted)
        for who in people
    ]


def _estimated(row: ModelRow, found: Estimate) -> ModelRow:
    note = "; ".join(filter(None, (found.note, row.note)))
    row = replace(
        row,
        estimate=found.value,
        error=found.error,
        df=found.df,
        low=found.low,
        high=found.high,
        p=found.p,
        note=note,
    )
    if row.model == MIXED:
        return row
    return replace(
        row, odds_ratio=exp(found.value), odds_ratio_low=exp(found.low), odds_ratio_high=exp(found.high)
    )


def _robust(row: ModelRow, without: Sequence[Estimate | NoFit]) -> ModelRow:
    """The row with what becomes of its effect without one participant."""
    fitted = [each for each in without if isinstance(each, Estimate)]
    if not fitted:
        return row
    values, probabilities = [each.value for each in fitted], [each.p for each in fitted]
    return replace(
        row,
        without_one=len(fitted),
        without_one_least=min(values),
        without_one_most=max(values),
        without_one_p_least=min(probabilities),
        without_one_p_most=max(probabilities),
    )


def _label(plan: Plan | None, row: ModelRow) -> str:
    """What a plan has an effect as; whatever it does not name is exploratory."""
    judged = plan is not None and plan.hypotheses_of(row.family, row.quantity)
    return CONFIRMATORY if judged else EXPLORATORY
