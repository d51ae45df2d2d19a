"""Regression models of answers, scores, success and reward in trials."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp
from typing import Annotated

from avrgym.analysis.answers.trial_answers import AFTER_TRIAL, find_questionnaires_at_moment
from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    FamilyName,
    GroupAName,
    GroupBName,
    HolmCorrectedPValue,
    IsSimulated,
    Note,
    PlanStatus,
    PrimaryCorrectedPValue,
    PValue,
    QuantityName,
    ResultRole,
    SignificanceStars,
)
from avrgym.analysis.models.effects import EFFECT_KINDS, Effect, TrialValue, list_effects_of_interest
from avrgym.analysis.models.estimate import EffectEstimate, ModelFitError
from avrgym.analysis.models.fitting import (
    LOGISTIC_MODEL,
    MIXED_MODEL,
    ORDINAL_MODEL,
    EstimateByEffect,
    drop_constant_groups,
    estimate_effects,
)
from avrgym.analysis.reading.study_data import StudyData, TrialKey
from avrgym.analysis.reading.table_rows import AttemptRow
from avrgym.analysis.statistics.rank_tests import apply_holm_correction
from avrgym.questionnaires.questionnaire import Item, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.plan.analysis_plan import CONFIRMATORY_STATUS, EXPLORATORY_STATUS, AnalysisPlan
from avrgym.system.columns import Column

NO_ESTIMATE_TEXT = "the effect could not be estimated"
NO_ODDS_RATIO_TEXT = f"{NO_ESTIMATE_TEXT}, or the model is mixed"


@dataclass(frozen=True, kw_only=True)
class ModelEffectRow:
    """One effect in the regression model of ``quantity``: ``group_a`` minus ``group_b``."""

    simulated: IsSimulated
    questionnaire: Annotated[str, Column("Questionnaire of the quantity.", empty="success and reward")] = ""
    family: FamilyName
    quantity: QuantityName
    model: Annotated[str, Column("Kind of model.", allowed="ordinal, logistic, mixed")]
    effect: Annotated[str, Column("Kind of effect.", allowed=", ".join(EFFECT_KINDS))]
    group_a: GroupAName
    group_b: GroupBName
    participants: Annotated[int, Column("Number of participants with values.", allowed=AT_LEAST_0_TEXT)]
    values: Annotated[int, Column("Number of trials with values.", allowed=AT_LEAST_0_TEXT)]
    estimate: Annotated[
        float | None,
        Column(
            "Estimate: log odds ratio; of mixed models in the unit of the quantity.", empty=NO_ESTIMATE_TEXT
        ),
    ] = None
    error: Annotated[float | None, Column("Standard error.", "", "1", AT_LEAST_0_TEXT, NO_ESTIMATE_TEXT)] = (
        None
    )
    df: Annotated[
        float | None, Column("Degrees of freedom of Student's t.", "", "1", AT_LEAST_0_TEXT, NO_ESTIMATE_TEXT)
    ] = None
    low: Annotated[
        float | None, Column("Lower bound of the 95 % confidence interval.", empty=NO_ESTIMATE_TEXT)
    ] = None
    high: Annotated[
        float | None, Column("Upper bound of the 95 % confidence interval.", empty=NO_ESTIMATE_TEXT)
    ] = None
    odds_ratio: Annotated[
        float | None, Column("Odds ratio: exp(estimate).", "", "1", AT_LEAST_0_TEXT, NO_ODDS_RATIO_TEXT)
    ] = None
    odds_ratio_low: Annotated[
        float | None,
        Column("Lower bound of its 95 % confidence interval.", "", "1", AT_LEAST_0_TEXT, NO_ODDS_RATIO_TEXT),
    ] = None
    odds_ratio_high: Annotated[
        float | None,
        Column("Upper bound of its 95 % confidence interval.", "", "1", AT_LEAST_0_TEXT, NO_ODDS_RATIO_TEXT),
    ] = None
    p: PValue = None
    p_holm: HolmCorrectedPValue = None
    p_primary: PrimaryCorrectedPValue = None
    stars: SignificanceStars = ""
    leave_one_out: Annotated[
        int,
        Column("Number of leave-one-participant-out models that could be fitted.", allowed=AT_LEAST_0_TEXT),
    ] = 0
    leave_one_out_min: Annotated[
        float | None, Column("Smallest of their estimates.", empty=NO_ESTIMATE_TEXT)
    ] = None
    leave_one_out_max: Annotated[
        float | None, Column("Largest of their estimates.", empty=NO_ESTIMATE_TEXT)
    ] = None
    leave_one_out_p_min: Annotated[
        float | None,
        Column("Smallest of their p values.", allowed=FRACTION_RANGE_TEXT, empty=NO_ESTIMATE_TEXT),
    ] = None
    leave_one_out_p_max: Annotated[
        float | None,
        Column("Largest of their p values.", allowed=FRACTION_RANGE_TEXT, empty=NO_ESTIMATE_TEXT),
    ] = None
    role: ResultRole = ""
    plan_status: PlanStatus = ""
    note: Note = ""


MAX_ORDINAL_POINTS = 11
"""Maximum number of scale points for an ordinal model. For answers on longer scales, a mixed model is fitted."""
SUCCESS_QUANTITY, REWARD_QUANTITY = "success", "reward"
ANSWERS_TABLE, SCORES_TABLE, TRIALS_TABLE = "answers", "scores", "trials"
"""Names of the tables that contain the dependent variables of the models."""


@dataclass(frozen=True)
class ModelGroup:
    """Quantities (items, scales, success or reward) with regression models. Their tests are corrected together for
    multiple testing.

    ``model_kind_by_quantity``: kind of model (ordinal, logistic, mixed) by quantity. ``table_name``: name of the
    table with the values. ``questionnaire``: name of the questionnaire of answers or scores; empty for success and
    reward.
    """

    name: str
    model_kind_by_quantity: Mapping[str, str]
    table_name: str
    questionnaire: str = ""

    def make_family_name(self, kind: str) -> str:
        """Returns the name of the family of tests of one kind of effect. Tests of a family are corrected together."""
        return f"{kind}, {self.name}"


def list_model_groups(design: Design) -> Iterator[ModelGroup]:
    """Yields the model groups of a study design: answers, scores, then success and reward."""
    rated = find_questionnaires_at_moment(design, AFTER_TRIAL)
    for questionnaire in rated:
        models = {item.id: _model_of_item(item) for item in questionnaire.items}
        yield ModelGroup(
            _name_of_group(questionnaire, len(rated) > 1), models, ANSWERS_TABLE, questionnaire.name
        )
    for questionnaire in rated:
        if questionnaire.instrument is not None:
            scales = dict.fromkeys(questionnaire.instrument.scale_names, MIXED_MODEL)
            yield ModelGroup(
                f"models of scores of {questionnaire.name}", scales, SCORES_TABLE, questionnaire.name
            )
    yield ModelGroup(
        "models of success and reward",
        {SUCCESS_QUANTITY: LOGISTIC_MODEL, REWARD_QUANTITY: MIXED_MODEL},
        TRIALS_TABLE,
    )


def _name_of_group(questionnaire: Questionnaire, several: bool) -> str:
    return f"models of answers to {questionnaire.name}" if several else "models of answers"


def _model_of_item(item: Item) -> str:
    return ORDINAL_MODEL if item.points <= MAX_ORDINAL_POINTS else MIXED_MODEL


def list_model_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for all regression models. A plan can contain these families."""
    kinds = {effect.kind for effect in list_effects_of_interest(design)}
    return {
        source.make_family_name(kind): tuple(source.model_kind_by_quantity)
        for source in list_model_groups(design)
        for kind in EFFECT_KINDS
        if kind in kinds
    }


def collect_trial_values(
    design: Design, data: StudyData, simulated: bool, source: ModelGroup
) -> Mapping[str, list[TrialValue]]:
    """Returns the values by quantity in the analysed trials of people, or of simulated participants."""
    counted = {
        (row.participant, row.position) for row in data.trials if row.counted and row.simulated is simulated
    }
    course = find_trial_positions(design, data.attempts)
    found: dict[str, list[TrialValue]] = {quantity: [] for quantity in source.model_kind_by_quantity}
    for quantity, key, value in _values(data, source):
        if quantity in found and key in counted and key in course:
            found[quantity].append(replace(course[key], value=value))
    return found


def _values(data: StudyData, source: ModelGroup) -> Iterator[tuple[str, TrialKey, float]]:
    """Yields (quantity, trial key, value) for each value in the table of the model group."""
    if source.table_name == ANSWERS_TABLE:
        for row in data.answers:
            if row.counted and row.position is not None and row.questionnaire == source.questionnaire:
                yield row.item, (row.participant, row.position), float(row.value)
    elif source.table_name == SCORES_TABLE:
        for row in data.scores:
            about = row.counted and row.position is not None and row.questionnaire == source.questionnaire
            if about and row.score is not None and row.position is not None:
                yield row.scale, (row.participant, row.position), row.score
    else:
        for row in data.trials:
            if row.success is not None:
                yield SUCCESS_QUANTITY, (row.participant, row.position), float(row.success)
            if row.reward is not None:
                yield REWARD_QUANTITY, (row.participant, row.position), row.reward


def find_trial_positions(design: Design, attempts: Sequence[AttemptRow]) -> dict[TrialKey, TrialValue]:
    """Returns condition and position of each completed trial, without practice trials. ``value`` is always 0."""
    found: dict[TrialKey, TrialValue] = {}
    blocks, places = max(len(design.tasks) - 1, 1), max(len(design.robot_policy_pairs) - 1, 1)
    block, place = 0, 0
    last: AttemptRow | None = None
    for row in (each for each in attempts if each.state == "completed"):
        if last is None or last.participant != row.participant:
            block, place, last = 0, 0, None
        elif last.task != row.task:
            block, place = block + 1, 0
        same = last is not None and last.task == row.task
        if not row.practice:
            found[row.participant, row.position] = TrialValue(
                row.participant, row.task, row.robot, row.policy,
                min(block / blocks, 1.0), min(place / places, 1.0), last.policy if last and same else None, 0.0,
            )  # fmt: skip
            place += 1
        last = row
    return found


def make_model_effect_rows(
    design: Design, data: StudyData, plan: AnalysisPlan | None = None
) -> list[ModelEffectRow]:
    """Returns a row for each effect on each quantity, separately for people and simulated participants.

    Effects in the hypotheses of ``plan`` are confirmatory, all others exploratory.
    """
    rows: list[ModelEffectRow] = []
    for simulated in sorted({row.simulated for row in data.trials if row.counted}):
        for source in list_model_groups(design):
            rows += make_model_group_rows(
                design, source, simulated, collect_trial_values(design, data, simulated, source)
            )
    return [replace(row, plan_status=_label(plan, row)) for row in rows]


def make_model_group_rows(
    design: Design, source: ModelGroup, simulated: bool, values: Mapping[str, Sequence[TrialValue]]
) -> list[ModelEffectRow]:
    """Returns a row for each effect on each quantity of a model group, sorted by kind of effect.

    p values are corrected by Holm's method within each kind of effect.
    """
    found = [row for each in values.items() for row in _quantity_rows(design, source, simulated, *each)]
    rows: list[ModelEffectRow] = []
    for kind in EFFECT_KINDS:
        own = [row for row in found if row.effect == kind]
        adjusted = apply_holm_correction([row.p for row in own])
        rows += [replace(row, p_holm=p) for row, p in zip(own, adjusted, strict=True)]
    return rows


def _quantity_rows(
    design: Design, source: ModelGroup, simulated: bool, quantity: str, observed: Sequence[TrialValue]
) -> Iterator[ModelEffectRow]:
    """Yields a row for each effect in the model of one quantity."""
    model, wanted = source.model_kind_by_quantity[quantity], list_effects_of_interest(design)
    kept, left_out = drop_constant_groups(model, observed)
    found, without = (
        estimate_effects(design, model, observed, wanted),
        _leave_one_out(design, model, observed, wanted),
    )
    for effect in wanted:
        estimate = found[effect]
        row = ModelEffectRow(
            simulated=simulated,
            questionnaire=source.questionnaire,
            family=source.make_family_name(effect.kind),
            quantity=quantity,
            model=model,
            effect=effect.kind,
            group_a=effect.group_a,
            group_b=effect.group_b,
            participants=len({each.participant for each in kept}),
            values=len(kept),
            note=left_out,
        )
        if isinstance(estimate, ModelFitError):
            yield replace(row, note="; ".join(filter(None, (str(estimate), left_out))))
        else:
            yield _with_leave_one_out(_estimated(row, estimate), [each[effect] for each in without])


def _leave_one_out(
    design: Design, model: str, observed: Sequence[TrialValue], wanted: Sequence[Effect]
) -> list[EstimateByEffect]:
    """Returns the estimates of the effects from each leave-one-participant-out model."""
    people = dict.fromkeys(each.participant for each in observed)
    return [
        estimate_effects(design, model, [each for each in observed if each.participant != name], wanted)
        for name in people
    ]


def _estimated(row: ModelEffectRow, found: EffectEstimate) -> ModelEffectRow:
    note = "; ".join(filter(None, (found.note, row.note)))
    row = replace(
        row,
        estimate=found.value,
        error=found.standard_error,
        df=found.df,
        low=found.ci_low,
        high=found.ci_high,
        p=found.p,
        note=note,
    )
    if row.model == MIXED_MODEL:
        return row
    return replace(
        row, odds_ratio=exp(found.value), odds_ratio_low=exp(found.ci_low), odds_ratio_high=exp(found.ci_high)
    )


def _with_leave_one_out(
    row: ModelEffectRow, without: Sequence[EffectEstimate | ModelFitError]
) -> ModelEffectRow:
    """Returns the row with minimum and maximum of estimate and p value over the leave-one-participant-out models."""
    fitted = [each for each in without if isinstance(each, EffectEstimate)]
    if not fitted:
        return row
    values, probabilities = [each.value for each in fitted], [each.p for each in fitted]
    return replace(
        row,
        leave_one_out=len(fitted),
        leave_one_out_min=min(values),
        leave_one_out_max=max(values),
        leave_one_out_p_min=min(probabilities),
        leave_one_out_p_max=max(probabilities),
    )


def _label(plan: AnalysisPlan | None, row: ModelEffectRow) -> str:
    """Returns the plan status of an effect: confirmatory if a hypothesis contains it, otherwise exploratory."""
    judged = plan is not None and plan.find_hypotheses(row.family, row.quantity)
    return CONFIRMATORY_STATUS if judged else EXPLORATORY_STATUS
