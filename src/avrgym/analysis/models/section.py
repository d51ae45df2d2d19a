"""Report section with the regression models: effects, confidence intervals, and leave-one-out estimates."""

from collections.abc import Sequence
from math import exp

from avrgym.analysis.models.effects import EFFECT_KINDS, POLICY_EFFECT
from avrgym.analysis.models.regression_models import ModelEffectRow
from avrgym.analysis.page.html_elements import (
    Markup,
    format_number,
    format_p_value,
    join_markup,
    render_badge,
    render_table,
    tag,
)
from avrgym.analysis.page.hypothesis_test_tables import format_corrected_p
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS
from avrgym.study.plan.analysis_plan import EXPLORATORY_STATUS

EFFECT_TITLES = {
    "policies": "Policies",
    "robots": "Robots",
    "learning": "Learning: position of the task in the session",
    "order": "Order: position of the trial within its task",
    "carry-over": "Carry-over: policy of the previous trial",
}
MODELS_NOTE = (
    "Each model has policy, robot, task, position in the session and previous policy as fixed effects, and "
    "participants as clusters. Effects on answers and success are odds ratios: above 1, higher answers or successes "
    "are likelier in the first group. Effects on rewards and scores are differences in their own units. Confidence "
    "intervals and p use Student's t with a correction for few participants. Leave-one-out estimates show whether a "
    "result depends on a single participant."
)


def render_models_section(models: Sequence[ModelEffectRow], simulated: bool) -> Markup:
    """Returns the report section about the models of one group: policy effects first. Empty without models."""
    own = [row for row in models if row.simulated is simulated]
    kinds = [kind for kind in EFFECT_KINDS if any(row.effect == kind for row in own)]
    head = tag("h3", "Regression models")
    reasons = {row.note for row in own if row.estimate is None}
    if not kinds:
        return Markup()
    if len(reasons) == 1 and all(row.estimate is None for row in own):
        return tag("section", head, tag("p", f"No model was fitted: {reasons.pop()}."))
    shown = {kind: _kind(kind, [row for row in own if row.effect == kind], simulated) for kind in kinds}
    others = [
        tag("details", tag("summary", EFFECT_TITLES[kind]), shown[kind])
        for kind in kinds
        if kind != POLICY_EFFECT
    ]
    mark = [render_badge("SIMULATED PARTICIPANTS")] if simulated else []
    first = [shown[POLICY_EFFECT]] if POLICY_EFFECT in shown else []
    return tag("section", head, *mark, tag("p", MODELS_NOTE), *first, *others)


def _kind(kind: str, rows: Sequence[ModelEffectRow], simulated: bool) -> Markup:
    """Returns a table for each family of tests of one kind of effect."""
    families = dict.fromkeys(row.family for row in rows)
    return join_markup(
        [_family([row for row in rows if row.family == family], kind, simulated) for family in families]
    )


def _family(rows: Sequence[ModelEffectRow], kind: str, simulated: bool) -> Markup:
    source, questionnaire = rows[0].family.removeprefix(f"{kind}, "), rows[0].questionnaire
    named = source if questionnaire in source else f"{source} to {questionnaire}"
    return render_effects_table(f"{EFFECT_TITLES[kind]}; {named}", rows, simulated)


def render_effects_table(caption: str, rows: Sequence[ModelEffectRow], simulated: bool) -> Markup:
    """Returns a table of effects. The columns corrected p, plan status and note are omitted if they are empty."""
    corrected = any(row.p_primary is not None for row in rows)
    planned, noted = any(row.plan_status != EXPLORATORY_STATUS for row in rows), any(row.note for row in rows)
    heads = (
        "Quantity", "Groups", "n", "Effect [95 % CI]", "p", "p, Holm", *(["p, corrected"] if corrected else []),
        "Leave-one-out", "p", "Role",
        *(["Plan"] if planned else []), *(["Note"] if noted else []),
    )  # fmt: skip
    body = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.participants, format_effect(row), format_p_value(row.p),
            format_p_value(row.p_holm), *([format_corrected_p(row.p_primary)] if corrected else []),
            _leave_one_out(row), _probabilities(row), row.role,
            *([row.plan_status] if planned else []), *([row.note] if noted else []),
        )
        for row in rows
    ]  # fmt: skip
    marked = (
        caption
        + ("" if planned else "; all exploratory")
        + (" (simulated participants)" if simulated else "")
    )
    return render_table(marked, heads, body, numbers=range(2, 9 if corrected else 8))


def format_effect(row: ModelEffectRow) -> str:
    """Returns the odds ratio or the difference as text, with its confidence interval."""
    if row.odds_ratio is not None:
        return f"{_ratio(row.odds_ratio)} × [{_ratio(row.odds_ratio_low)}, {_ratio(row.odds_ratio_high)}]"
    if row.estimate is None:
        return "–"
    return f"{format_number(row.estimate)} [{format_number(row.low)}, {format_number(row.high)}]"


def _ratio(value: float | None) -> str:
    """Returns an odds ratio as text: with two decimals below 100, without decimals from 100."""
    if value is None:
        return "–"
    return (
        "> 999"
        if value > 999
        else "< 0.01"
        if value < 0.01
        else f"{value:.2f}"
        if value < 100
        else f"{value:.0f}"
    )


def _leave_one_out(row: ModelEffectRow) -> str:
    """Returns the range of leave-one-participant-out estimates as text, as odds ratios or in the unit of the effect."""
    minimum, maximum = row.leave_one_out_min, row.leave_one_out_max
    if minimum is None or maximum is None:
        return "–"
    if row.odds_ratio is not None:
        return f"{_ratio(exp(minimum))} to {_ratio(exp(maximum))} ×"
    return f"{format_number(minimum)} to {format_number(maximum)}"


def _probabilities(row: ModelEffectRow) -> str:
    minimum, maximum = row.leave_one_out_p_min, row.leave_one_out_p_max
    return "–" if minimum is None else f"{format_p_value(minimum)} to {format_p_value(maximum)}"


MODELS_METHOD_TEXT = (
    "Regression models: ordinal answers have a proportional odds model, success a logistic regression. Both are "
    "fitted by generalised estimating equations with participants as clusters, with the covariance of Kauermann and "
    "Carroll for few clusters, and Student's t with one degree of freedom less than participants. Rewards, scores and "
    "long scales have a linear mixed model with random effects of participant, participant by policy, by robot and by "
    "task, and the standard errors and degrees of freedom of Kenward and Roger. A mixed model is singular if the "
    f"variance of a random effect is zero or negative. Fewer than {MIN_PARTICIPANTS} participants are not modelled. "
    "Tasks and robots with all values at the same end of a scale are excluded and listed. Models are exploratory "
    "unless a frozen plan names them.",
)
