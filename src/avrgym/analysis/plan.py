"""Frozen analysis plan: available tests, plan status of results, and deviations from the plan."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import msgspec

from avrgym.analysis.answers.scores import score_change_question, score_policy_question
from avrgym.analysis.answers.session_answers import session_change_question, session_questionnaires
from avrgym.analysis.answers.trial_answers import (
    AFTER_TRIAL,
    midpoint_question,
    policy_comparison_question,
    questionnaires_at_moment,
)
from avrgym.analysis.biomechanics.tests import (
    HEAD_AXIS_QUESTION,
    HEAD_POSITION_QUESTION,
    TORSO_HEIGHT_QUESTION,
)
from avrgym.analysis.biomechanics.training_people import AXIS_NAMES, task_posture
from avrgym.analysis.models.models import ModelRow, model_tests
from avrgym.analysis.models.section import effects_table
from avrgym.analysis.outcomes.outcomes import outcome_tests
from avrgym.analysis.page.comparisons import hypothesis_test_table
from avrgym.analysis.page.elements import Markup, bullet_list, join_markup, tag
from avrgym.analysis.reading.study_data import StudyData
from avrgym.analysis.statistics.comparisons import (
    PARTICIPANT_UNIT,
    TRIAL_UNIT,
    ComparisonFamily,
    ComparisonRow,
    ResearchQuestion,
)
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Questionnaire
from avrgym.study.checking.finding import Finding, excluded_trial_finding
from avrgym.study.design.design import Design
from avrgym.study.plan.deviations import deviations
from avrgym.study.plan.frozen_plan import read_frozen_plan as read_plan_of_study
from avrgym.study.plan.plan import EXPLORATORY, NOT_PLANNED, Hypothesis, Plan
from avrgym.study.plan.plan import FILE as PLAN_FILE
from avrgym.study.storage.store import Store

ANALYSIS_UNITS = (TRIAL_UNIT, PARTICIPANT_UNIT)
SuggestedHypothesis = tuple[str, list[str], ResearchQuestion]
"""A suggested hypothesis: (text, quantities, research question of its tests)."""


def required_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for the test families that each plan must contain."""
    return {
        question.family_name(unit): tuple(quantities)
        for question, units, quantities in _questions(design)
        for unit in units
    }


def optional_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for the test families that are optional in a plan.

    These are tests of objective measures and of model effects. They are exploratory if the plan does not contain them.
    """
    return outcome_tests(design) | model_tests(design)


def available_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Returns the quantities by test family, for all required and optional test families of a plan."""
    return required_tests(design) | optional_tests(design)


def _questions(design: Design) -> Iterator[tuple[ResearchQuestion, Sequence[str], Sequence[str]]]:
    """Yields (research question, units of analysis, quantities) for the required tests."""
    rated = questionnaires_at_moment(design, AFTER_TRIAL)
    for questionnaire in rated[:1]:
        yield midpoint_question(questionnaire), ANALYSIS_UNITS, [questionnaire.items[0].id]
    for questionnaire in rated if len(design.policies) > 1 else ():
        yield (
            policy_comparison_question(design, questionnaire),
            ANALYSIS_UNITS,
            [item.id for item in questionnaire.items],
        )
    for questionnaire in session_questionnaires(design):
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments):
            items = [item.id for item in questionnaire.items]
            yield session_change_question(questionnaire), [PARTICIPANT_UNIT], items
    yield from _about_scores(design)
    postures = dict.fromkeys(task_posture(task) for task in design.tasks)
    yield TORSO_HEIGHT_QUESTION, ANALYSIS_UNITS, ["torso_height_m"]
    yield (
        HEAD_AXIS_QUESTION,
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
            yield score_policy_question(questionnaire), ANALYSIS_UNITS, scales
        if set(SESSION_QUESTION_MOMENTS) <= set(questionnaire.moments):
            yield score_change_question(questionnaire), [PARTICIPANT_UNIT], scales


def suggested_hypotheses(design: Design) -> tuple[Hypothesis, ...]:
    """Returns the hypotheses of the paper for this design, for a template of a plan. All tests are by participant."""
    rated = questionnaires_at_moment(design, AFTER_TRIAL)
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
        Hypothesis(f"H{number}", text, tuple(measures), (question.family_name(PARTICIPANT_UNIT),))
        for number, (text, measures, question) in enumerate(expected, start=1)
    )


def _above_midpoint(questionnaire: Questionnaire) -> SuggestedHypothesis:
    item = questionnaire.items[0]
    scale = f"{questionnaire.scale_of(item).middle_value:g}, the middle of its scale"
    text = f"With each policy participants rate {item.id} ({item.text}) above {scale}."
    return text, [item.id], midpoint_question(questionnaire)


def _better_policy(design: Design, questionnaire: Questionnaire) -> SuggestedHypothesis:
    items = [item.id for item in questionnaire.items]
    text = f"Participants rate {', '.join(items)} higher with {design.policies[-1]} than with {design.policies[0]}."
    return text, items, policy_comparison_question(design, questionnaire)


@dataclass(frozen=True, eq=False)
class FrozenPlan:
    """The frozen plan of a study, and the deviations from it.

    ``frozen_at``: time of freezing. ``plan``: ``None`` if its contents are unknown. ``origin_text``: sentence about the
    date of the plan. ``is_confirmatory``: whether the plan was certainly frozen before the first participant was
    enrolled. ``plan_sha256``: checksum of ``plan.toml``. ``record_sha256``: checksum of ``plan-frozen.json``.
    """

    frozen_at: str
    plan: Plan | None
    plan_sha256: str | None
    deviations: list[Finding]
    origin_text: str
    is_confirmatory: bool
    record_sha256: str

    @property
    def confirmatory_plan(self) -> Plan | None:
        """Returns the plan if its tests are confirmatory; otherwise ``None``."""
        return self.plan if self.is_confirmatory else None


def read_frozen_plan(store: Store, design: Design, observed: StudyData) -> FrozenPlan | None:
    """Returns the frozen plan with the deviations from it; ``None`` if no plan is frozen."""
    frozen = read_plan_of_study(store)
    if frozen is None:
        return None
    exclusions = [
        excluded_trial_finding(row.participant, row.position, row.left_out)
        for row in observed.trials
        if row.left_out
    ]
    found = deviations(store, frozen, required_tests(design), exclusions, optional_tests(design))
    record = frozen.record
    return FrozenPlan(
        frozen_at=frozen.existed_since_text,
        plan=record.parsed_plan() if record else None,
        plan_sha256=record.sha256[PLAN_FILE] if record else None,
        deviations=found,
        origin_text=frozen.origin_text,
        is_confirmatory=frozen.is_confirmatory,
        record_sha256=frozen.sha256,
    )


def add_plan_status(families: list[ComparisonFamily], plan: Plan, design: Design) -> list[ComparisonFamily]:
    """Returns the families with the plan status of each test. Optional tests that the plan lacks are exploratory."""
    optional = optional_tests(design)

    def label(row: ComparisonRow) -> str:
        by_plan = plan.plan_status(row.family, row.quantity)
        return EXPLORATORY if by_plan == NOT_PLANNED and row.family in optional else by_plan

    return [
        replace(family, rows=tuple(replace(row, plan_status=label(row)) for row in family.rows))
        for family in families
    ]


def plan_results(plan: FrozenPlan) -> dict[str, Any]:
    """Returns the frozen plan and the deviations from it, for ``results.json``."""
    return {
        "frozen_at": plan.frozen_at,
        "sha256": plan.plan_sha256,
        "record_sha256": plan.record_sha256,
        "origin": plan.origin_text,
        "is_confirmatory": plan.is_confirmatory,
        "plan": None if plan.plan is None else msgspec.to_builtins(plan.plan),
        "deviations": [{"where": each.where, "message": each.message} for each in plan.deviations],
    }


NO_PLAN_TEXT = (
    "No plan was frozen before the first participant: nothing was preregistered, every test is exploratory."
)


def plan_section(plan: FrozenPlan | None) -> Markup:
    """Returns the report section about the frozen plan and the deviations from it; empty without a frozen plan."""
    if plan is None:
        return Markup()
    parts = (_frozen_text(plan), _deviations(plan))
    return tag("section", tag("h2", "The plan"), *parts, id="plan")


def _frozen_text(frozen: FrozenPlan) -> Markup:
    if frozen.plan is None:
        return tag("p", "The record of a frozen plan is missing or damaged: nothing is confirmatory.")
    plan = frozen.plan
    tests = (
        "Tests of its hypotheses are confirmatory, all others are exploratory."
        if frozen.is_confirmatory
        else ""
    )
    words = (
        f"{frozen.origin_text} The SHA-256 of plan.toml is {frozen.plan_sha256}, "
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
        [tag("p", words), bullet_list([f"{name}: {text}" for name, text in said.items() if text])]
    )


def _deviations(frozen: FrozenPlan) -> Markup:
    found = [f"{each.where}: {each.message}." for each in frozen.deviations]
    if not found:
        return join_markup([tag("h3", "Deviations"), tag("p", "None.")])
    return join_markup([tag("h3", "Deviations"), bullet_list(found)])


def confirmatory_section(
    plan: Plan | None, tests: Sequence[ComparisonRow], models: Sequence[ModelRow], simulated: bool
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
    plan: Plan,
    hypothesis: Hypothesis,
    tests: Sequence[ComparisonRow],
    models: Sequence[ModelRow],
    simulated: bool,
) -> Markup:
    def judged(row: ComparisonRow | ModelRow) -> bool:
        return row.simulated is simulated and hypothesis in plan.hypotheses_of(row.family, row.quantity)

    own_tests, effects = list(filter(judged, tests)), list(filter(judged, models))
    caption = f"{hypothesis.id}: {', '.join(hypothesis.tests)}"
    parts = [hypothesis_test_table(caption, own_tests, simulated)] if own_tests else []
    parts += [effects_table(caption, effects, simulated)] if effects else []
    return join_markup(
        [
            tag("p", f"{hypothesis.id}: {hypothesis.text}"),
            *(parts or [tag("p", "There are no data to test yet.")]),
        ]
    )
