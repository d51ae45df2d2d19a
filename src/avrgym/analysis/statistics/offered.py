"""Which tests the analysis of a design does, before there is anything to test: what a plan may name."""

from collections.abc import Iterator, Sequence
from itertools import product

from avrgym.analysis.reading.trained_people import AXES, posture_of
from avrgym.analysis.statistics.biomechanics_tests import HEADS, HEIGHTS, WHOLE_HEADS
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL, Question
from avrgym.analysis.statistics.models.quantities import offered_models
from avrgym.analysis.statistics.objective_tests import offered_objective
from avrgym.analysis.statistics.scores import scores_change_question, scores_policies_question
from avrgym.analysis.statistics.session_answers import about_sessions, change_question
from avrgym.analysis.statistics.subjective import (
    AFTER_TRIAL,
    asked_at,
    middle_question,
    policies_question,
)
from avrgym.questionnaires.questionnaire import SESSION_MOMENTS, Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.plan.plan import Hypothesis

BOTH = (TRIAL, PARTICIPANT)
Expected = tuple[str, list[str], Question]
"""A hypothesis in words, its measures, and what their tests ask."""


def offered_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """The families of tests of a design's analysis by name, each with the quantities that it takes."""
    return {
        question.by(unit): tuple(quantities)
        for question, units, quantities in _questions(design)
        for unit in units
    }


def optional_tests(design: Design) -> dict[str, tuple[str, ...]]:
    """Tests that a plan need not name: of objective measures, and effects in models. They are then exploratory."""
    return offered_objective(design) | offered_models(design)


def nameable(design: Design) -> dict[str, tuple[str, ...]]:
    """All tests that a plan may name: those that it must name, and those that it need not name."""
    return offered_tests(design) | optional_tests(design)


def _questions(design: Design) -> Iterator[tuple[Question, Sequence[str], Sequence[str]]]:
    """Each question with what its values may stand for, and its quantities."""
    rated = asked_at(design, AFTER_TRIAL)
    for questionnaire in rated[:1]:
        yield middle_question(questionnaire), BOTH, [questionnaire.items[0].id]
    for questionnaire in rated if len(design.policies) > 1 else ():
        yield policies_question(design, questionnaire), BOTH, [item.id for item in questionnaire.items]
    for questionnaire in about_sessions(design):
        if set(SESSION_MOMENTS) <= set(questionnaire.moments):
            items = [item.id for item in questionnaire.items]
            yield change_question(questionnaire), [PARTICIPANT], items
    yield from _about_scores(design)
    postures = dict.fromkeys(posture_of(task) for task in design.tasks)
    yield HEIGHTS, BOTH, ["torso_height_m"]
    yield HEADS, BOTH, [f"head_{axis}_m, {posture}" for posture, axis in product(postures, AXES)]
    yield WHOLE_HEADS, [PARTICIPANT], [f"head_m, {posture}" for posture in postures]


def _about_scores(design: Design) -> Iterator[tuple[Question, Sequence[str], Sequence[str]]]:
    for questionnaire in design.questionnaires:
        if questionnaire.instrument is None:
            continue
        scales = questionnaire.instrument.scale_names
        if AFTER_TRIAL in questionnaire.moments and len(design.policies) > 1:
            yield scores_policies_question(questionnaire), BOTH, scales
        if set(SESSION_MOMENTS) <= set(questionnaire.moments):
            yield scores_change_question(questionnaire), [PARTICIPANT], scales


def suggested_hypotheses(design: Design) -> tuple[Hypothesis, ...]:
    """The paper's expectations for a design, each value a participant, as a plan to begin with."""
    rated = asked_at(design, AFTER_TRIAL)
    expected = [_above_the_middle(rated[0])] if rated else []
    if rated and len(design.policies) > 1:
        expected.append(_better_policy(design, rated[0]))
    expected = expected or [
        ("Participants are as tall as people of the training.", ["torso_height_m"], HEIGHTS)
    ]
    return tuple(
        Hypothesis(f"H{number}", text, tuple(measures), (question.by(PARTICIPANT),))
        for number, (text, measures, question) in enumerate(expected, start=1)
    )


def _above_the_middle(questionnaire: Questionnaire) -> Expected:
    item = questionnaire.items[0]
    scale = f"{questionnaire.scale_of(item).middle:g}, the middle of its scale"
    text = f"With each policy participants rate {item.id} ({item.text}) above {scale}."
    return text, [item.id], middle_question(questionnaire)


def _better_policy(design: Design, questionnaire: Questionnaire) -> Expected:
    items = [item.id for item in questionnaire.items]
    text = f"Participants rate {', '.join(items)} higher with {design.policies[-1]} than with {design.policies[0]}."
    return text, items, policies_question(design, questionnaire)
