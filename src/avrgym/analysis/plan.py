"""Frozen analysis plan: available tests, plan status of results, and deviations from the plan."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import msgspec

from avrgym.analysis.answers.scores import make_score_change_question, make_score_policy_question
from avrgym.analysis.answers.session_answers import find_session_questionnaires, make_session_change_question
from avrgym.analysis.answers.trial_answers import (
    AFTER_TRIAL,
    find_questionnaires_at_moment,
    make_midpoint_question,
    make_policy_comparison_question,
)
from avrgym.analysis.biomechanics.population_tests import (
    HEAD_POSITION_BY_AXIS_QUESTION,
    HEAD_POSITION_QUESTION,
    TORSO_HEIGHT_QUESTION,
)
from avrgym.analysis.biomechanics.training_populations import AXIS_NAMES, find_task_posture
from avrgym.analysis.models.regression_models import ModelEffectRow, list_model_tests
from avrgym.analysis.models.section import render_effects_table
from avrgym.analysis.outcomes.condition_outcomes import list_outcome_tests
from avrgym.analysis.page.html_elements import Markup, join_markup, render_bullet_list, tag
from avrgym.analysis.page.hypothesis_test_tables import render_hypothesis_test_table
from avrgym.analysis.reading.study_data import StudyData
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    ComparisonFamily,
    ComparisonRow,
    ResearchQuestion,
)
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Questionnaire
from avrgym.study.checking.finding import Finding, make_excluded_trial_finding
from avrgym.study.design.design import Design
from avrgym.study.plan.analysis_plan import EXPLORATORY_STATUS, NOT_PLANNED_STATUS, AnalysisPlan, Hypothesis
from avrgym.study.plan.analysis_plan import PLAN_FILE as PLAN_FILE
from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence as read_plan_of_study
from avrgym.study.plan.plan_deviations import find_deviations
from avrgym.study.storage.store import StudyStore

ANALYSIS_UNITS = (TRIAL_UNIT, PARTICIPANT_UNIT)
SuggestedHypothesis = tuple[str, list[str], ResearchQuestion]
"""A suggested hypothesis: (text, quantities, research question of its tests)."""


def list_required_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for the test families that each plan must contain."""
    return {
        question.make_family_name(unit): tuple(quantities)
        for question, units, quantities in _questions(design)
        for unit in units
    }


def list_optional_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for the test families that are optional in a plan.

    These are tests of objective measures and of model effects. They are exploratory if the plan does not contain them.
    """
    return list_outcome_tests(design) | list_model_tests(design)


def list_available_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for all required and optional test families of a plan."""
    return list_required_tests(design) | list_optional_tests(design)


def _questions(design: Design) -> Iterator[tuple[ResearchQuestion, Sequence[str], Sequence[str]]]:
    """Yields (research question, units of analysis, quantities) for the required tests."""
    rated = find_questionnaires_at_moment(design, AFTER_TRIAL)
    for questionnaire in rated[:1]:
        yield make_midpoint_question(questionnaire), ANALYSIS_UNITS, [questionnaire.items[0].id]
    for questionnaire in rated if len(design.policies) > 1 else ():
        yield (
            make_policy_comparison_question(design, questionnaire),
            ANALYSIS_UNITS,
            [item.id for item in questionnaire.items],
        )
    for questionnaire in find_session_questionnaires(design):
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments):
            items = [item.id for item in questionnaire.items]
            yield make_session_change_question(questionnaire), [PARTICIPANT_UNIT], items
    yield from _about_scores(design)
    postures = dict.fromkeys(find_task_posture(task) for task in design.tasks)
    yield TORSO_HEIGHT_QUESTION, ANALYSIS_UNITS, ["torso_height_m"]
    yield (
        HEAD_POSITION_BY_AXIS_QUESTION,
        ANALYSIS_UNITS,
        [f"head_{axis}_m, {posture}" for posture, axis in product(postures, AXIS_NAMES)],
    )
    yield HEAD_POSITION_QUESTION, [PARTICIPANT_UNIT], [f"head_m, {posture}" for posture in postures]


def _about_scores(design: Design) -> Iterator[tuple[ResearchQuestion, Sequence[str], Sequence[str]]]:
    for questionnaire in design.questionnaires:
        if questionnaire.instrument is None:
            continue
        scales = questionnaire.instrument.scale_names
        if AFTER_TRIAL in questionnaire.moments and len(design.policies) > 1:
            yield make_score_policy_question(questionnaire), ANALYSIS_UNITS, scales
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments):
            yield make_score_change_question(questionnaire), [PARTICIPANT_UNIT], scales


def suggest_hypotheses(design: Design) -> tuple[Hypothesis, ...]:
    """Returns the hypotheses of the paper for this design, for a template of a plan. All tests are by participant."""
    rated = find_questionnaires_at_moment(design, AFTER_TRIAL)
    expected = [_above_midpoint(rated[0])] if rated else []
    if rated and len(design.policies) > 1:
        expected.append(_better_policy(design, rated[0]))
    expected = expected or [
        (
            "Participants have the torso heights of the training populations.",
            ["torso_height_m"],
            TORSO_HEIGHT_QUESTION,
        )
    ]
    return tuple(
        Hypothesis(f"H{number}", text, tuple(measures), (question.make_family_name(PARTICIPANT_UNIT),))
        for number, (text, measures, question) in enumerate(expected, start=1)
    )


def _above_midpoint(questionnaire: Questionnaire) -> SuggestedHypothesis:
    item = questionnaire.items[0]
    scale = f"{questionnaire.find_response_scale(item).middle_value:g}, the middle of its scale"
    text = f"With each policy participants rate {item.id} ({item.text}) above {scale}."
    return text, [item.id], make_midpoint_question(questionnaire)


def _better_policy(design: Design, questionnaire: Questionnaire) -> SuggestedHypothesis:
    items = [item.id for item in questionnaire.items]
    text = f"Participants rate {', '.join(items)} higher with {design.policies[-1]} than with {design.policies[0]}."
    return text, items, make_policy_comparison_question(design, questionnaire)


@dataclass(frozen=True, eq=False)
class PlanWithDeviations:
    """The frozen plan of a study, and the deviations from it.

    ``frozen_at``: time of freezing. ``plan``: ``None`` if its contents are unknown. ``date_evidence_text``: sentence
    about the date of the plan. ``is_confirmatory``: whether the plan was certainly frozen before the first
    participant was enrolled. ``plan_sha256``: checksum of ``plan.toml``. ``record_sha256``: checksum of
    ``plan-frozen.json``.
    """

    frozen_at: str
    plan: AnalysisPlan | None
    plan_sha256: str | None
    deviations: list[Finding]
    date_evidence_text: str
    is_confirmatory: bool
    record_sha256: str

    @property
    def confirmatory_plan(self) -> AnalysisPlan | None:
        """Returns the plan if its tests are confirmatory; otherwise ``None``."""
        return self.plan if self.is_confirmatory else None


def read_plan_with_deviations(
    store: StudyStore, design: Design, observed: StudyData
) -> PlanWithDeviations | None:
    """Returns the frozen plan with the deviations from it; ``None`` if no plan is frozen."""
    frozen = read_plan_of_study(store)
    if frozen is None:
        return None
    exclusions = [
        make_excluded_trial_finding(row.participant, row.position, row.left_out)
        for row in observed.trials
        if row.left_out
    ]
    found = find_deviations(
        store, frozen, list_required_tests(design), exclusions, list_optional_tests(design)
    )
    record = frozen.frozen_plan
    return PlanWithDeviations(
        frozen_at=frozen.existed_since_text,
        plan=record.parse_plan() if record else None,
        plan_sha256=record.sha256[PLAN_FILE] if record else None,
        deviations=found,
        date_evidence_text=frozen.date_evidence_text,
        is_confirmatory=frozen.is_confirmatory,
        record_sha256=frozen.file_sha256,
    )


def add_plan_status(
    families: list[ComparisonFamily], plan: AnalysisPlan, design: Design
) -> list[ComparisonFamily]:
    """Returns the families with the plan status of each test. Optional tests that the plan lacks are exploratory."""
    optional = list_optional_tests(design)

    def label(row: ComparisonRow) -> str:
        by_plan = plan.find_test_status(row.family, row.quantity)
        return EXPLORATORY_STATUS if by_plan == NOT_PLANNED_STATUS and row.family in optional else by_plan

    return [
        replace(family, rows=tuple(replace(row, plan_status=label(row)) for row in family.rows))
        for family in families
    ]


def make_plan_results(plan: PlanWithDeviations) -> dict[str, Any]:
    """Returns the frozen plan and the deviations from it, for ``results.json``."""
    return {
        "frozen_at": plan.frozen_at,
        "sha256": plan.plan_sha256,
        "record_sha256": plan.record_sha256,
        "origin": plan.date_evidence_text,
        "is_confirmatory": plan.is_confirmatory,
        "plan": None if plan.plan is None else msgspec.to_builtins(plan.plan),
        "deviations": [{"where": each.where, "message": each.message} for each in plan.deviations],
    }


NO_PLAN_TEXT = (
    "No plan was frozen before the first participant: nothing was preregistered, every test is exploratory."
)


def render_plan_section(plan: PlanWithDeviations | None) -> Markup:
    """Returns the report section about the frozen plan and the deviations from it; empty without a frozen plan."""
    if plan is None:
        return Markup()
    parts = (_frozen_text(plan), _deviations(plan))
    return tag("section", tag("h2", "The plan"), *parts, id="plan")


def _frozen_text(frozen: PlanWithDeviations) -> Markup:
    if frozen.plan is None:
        return tag("p", "The record of a frozen plan is missing or damaged: nothing is confirmatory.")
    plan = frozen.plan
    tests = (
        "Tests of its hypotheses are confirmatory, all others are exploratory."
        if frozen.is_confirmatory
        else ""
    )
    words = (
        f"{frozen.date_evidence_text} The SHA-256 of plan.toml is {frozen.plan_sha256}, "
        f"that of plan-frozen.json {frozen.record_sha256}. {tests}"
    )
    said = {
        "Participants planned": str(plan.participants),
        "Sample size rationale": plan.sample_size_rationale,
        "Stopping rule": plan.stopping_rule,
        "Excluded": f"trials with tracking loss for more than {100 * plan.exclusion.max_held_share:g} % of the time",
        "Further exclusions": " ".join(plan.exclusion.other_rules),
        "Other decisions": plan.other,
    }
    return join_markup(
        [tag("p", words), render_bullet_list([f"{name}: {text}" for name, text in said.items() if text])]
    )


def _deviations(frozen: PlanWithDeviations) -> Markup:
    found = [f"{each.where}: {each.message}." for each in frozen.deviations]
    if not found:
        return join_markup([tag("h3", "Deviations"), tag("p", "None.")])
    return join_markup([tag("h3", "Deviations"), render_bullet_list(found)])


def render_confirmatory_section(
    plan: AnalysisPlan | None,
    tests: Sequence[ComparisonRow],
    models: Sequence[ModelEffectRow],
    simulated: bool,
) -> Markup:
    """Returns the report section with the tests of the hypotheses in the plan; empty without a plan."""
    if plan is None:
        return Markup()
    shown = [_hypothesis(plan, each, tests, models, simulated) for each in plan.hypotheses]
    note = (
        "These tests were planned. All other tests are exploratory. “p, corrected” is corrected over all primary "
        "results, “p, Holm” within one family only."
    )
    return tag("section", tag("h3", "Confirmatory results"), tag("p", note), *shown)


def _hypothesis(
    plan: AnalysisPlan,
    hypothesis: Hypothesis,
    tests: Sequence[ComparisonRow],
    models: Sequence[ModelEffectRow],
    simulated: bool,
) -> Markup:
    def judged(row: ComparisonRow | ModelEffectRow) -> bool:
        return row.simulated is simulated and hypothesis in plan.find_hypotheses(row.family, row.quantity)

    own_tests, effects = list(filter(judged, tests)), list(filter(judged, models))
    caption = f"{hypothesis.id}: {', '.join(hypothesis.tests)}"
    parts = [render_hypothesis_test_table(caption, own_tests, simulated)] if own_tests else []
    parts += [render_effects_table(caption, effects, simulated)] if effects else []
    return join_markup(
        [
            tag("p", f"{hypothesis.id}: {hypothesis.text}"),
            *(parts or [tag("p", "There are no data to test yet.")]),
        ]
    )
