"""The analysis plan of a study: the contents of ``plan.toml``. It must match the design and the available tests."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import msgspec

from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import Design
from avrgym.study.design.toml_validation import StructByKeyPath, ValidationError, parse_toml, read_text
from avrgym.study.plan.exclusion_rules import ExclusionRule, find_rule_error
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.toml_lines import ValuePath

PLAN_FILE = "plan.toml"
CONFIRMATORY_STATUS, EXPLORATORY_STATUS, NOT_PLANNED_STATUS = "confirmatory", "exploratory", "not in the plan"
AvailableTests = Mapping[str, Sequence[str]]
"""The measures of each test of the study's analysis, by the test's name."""
NonEmptyText = Annotated[str, msgspec.Meta(min_length=1)]
NonEmptyNames = Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]


class Hypothesis(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A hypothesis with its primary measures and its tests."""

    id: NonEmptyText
    text: NonEmptyText
    measures: NonEmptyNames
    tests: NonEmptyNames


class ExclusionRules(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Rules for the exclusion of trials and participants.

    ``max_held_share``: maximum share of time with tracking loss. ``other_rules``: further rules as text.
    ``rules``: rules that the analysis applies to participants.
    """

    max_held_share: float
    other_rules: tuple[NonEmptyText, ...] = msgspec.field(default=(), name="further")
    rules: tuple[ExclusionRule, ...] = ()


class AnalysisPlan(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The analysis plan of a study.

    Tests of a hypothesis are confirmatory for the hypothesis' measures. Tests in ``exploratory`` are exploratory for
    all other measures.
    """

    participants: int
    sample_size_rationale: str = ""
    stopping_rule: str = ""
    other: str = ""
    exploratory: tuple[str, ...] = ()
    exclusion: ExclusionRules
    hypotheses: Annotated[tuple[Hypothesis, ...], msgspec.Meta(min_length=1)]

    def find_hypotheses(self, test: str, measure: str) -> tuple[Hypothesis, ...]:
        """Returns the hypotheses that list both the test and the measure."""
        return tuple(each for each in self.hypotheses if test in each.tests and measure in each.measures)

    def find_test_status(self, test: str, measure: str) -> str:
        """Returns the plan status of a test of a measure: ``CONFIRMATORY_STATUS``, ``EXPLORATORY_STATUS`` or
        ``NOT_PLANNED_STATUS``.
        """
        if self.find_hypotheses(test, measure):
            return CONFIRMATORY_STATUS
        return EXPLORATORY_STATUS if test in self.exploratory else NOT_PLANNED_STATUS


_TABLES: StructByKeyPath = {
    ("hypotheses",): Hypothesis,
    ("exclusion",): ExclusionRules,
    ("exclusion", "rules"): ExclusionRule,
}


def read_analysis_plan(
    folder: Path, design: Design, available_tests: AvailableTests
) -> tuple[AnalysisPlan, str]:
    """Read the plan in a study's folder. Returns the plan and its text.

    Raises:
        DesignError: if the plan is invalid, or does not match the design or the available tests.
        StudyError: if there is no plan.
        OSError: if the file cannot be read.
    """
    if not (folder / PLAN_FILE).is_file():
        raise StudyError(
            f"{folder} contains no {PLAN_FILE}; `avrgym study freeze {folder}` writes a template"
        )
    text = read_text(folder / PLAN_FILE)
    return parse_analysis_plan(text, str(folder / PLAN_FILE), design, available_tests), text


def parse_analysis_plan(
    text: str, file_name: str, design: Design, available_tests: AvailableTests
) -> AnalysisPlan:
    """Returns the plan in a TOML text. Raises ``DesignError`` if the plan is invalid.

    ``file_name``: the file's name in error messages.
    """
    return parse_toml(
        text, file_name, AnalysisPlan, _TABLES, lambda plan: _check(plan, design, available_tests)
    )


def parse_frozen_analysis_plan(text: str, file_name: str) -> AnalysisPlan:
    """Returns a frozen plan. It is not compared with the current design and tests."""
    return parse_toml(text, file_name, AnalysisPlan, _TABLES, lambda plan: None)


def _check(plan: AnalysisPlan, design: Design, available_tests: AvailableTests) -> None:
    """Raises ``ValidationError`` for the first value that does not match the design or the tests."""
    _check_equal(("participants",), plan.participants, design.participants)
    _check_equal(("exclusion", "max_held_share"), plan.exclusion.max_held_share, design.max_held_share)
    _check_rules(plan.exclusion.rules, [item.id for item in design.list_items_at_moment("after_trial")])
    for index, test in enumerate(plan.exploratory):
        _check_known(("exploratory", index), "test", test, available_tests)
    known: set[str] = set()
    for index, hypothesis in enumerate(plan.hypotheses):
        if hypothesis.id in known:
            raise ValidationError(
                ("hypotheses", index, "id"), f"{hypothesis.id!r} is used twice; allowed: once"
            )
        known.add(hypothesis.id)
        _check_hypothesis(("hypotheses", index), hypothesis, available_tests)


def _check_rules(rules: Sequence[ExclusionRule], items: Sequence[str]) -> None:
    names: set[str] = set()
    for index, rule in enumerate(rules):
        fault = (
            f"{rule.name!r} is used twice; allowed: once"
            if rule.name in names
            else find_rule_error(rule, items)
        )
        if fault:
            raise ValidationError(("exclusion", "rules", index), fault)
        names.add(rule.name)


def _check_equal(place: ValuePath, planned: float, designed: float) -> None:
    if planned != designed:
        raise ValidationError(place, f"{place[-1]} is {planned:g}; allowed: {designed:g}, as in {DESIGN}")


def _check_hypothesis(place: ValuePath, hypothesis: Hypothesis, available_tests: AvailableTests) -> None:
    measures = dict.fromkeys(measure for taken in available_tests.values() for measure in taken)
    for index, test in enumerate(hypothesis.tests):
        _check_known((*place, "tests", index), "test", test, available_tests)
    for index, measure in enumerate(hypothesis.measures):
        _check_known((*place, "measures", index), "measure", measure, measures)
    taken = {measure for test in hypothesis.tests for measure in available_tests[test]}
    for index, measure in enumerate(hypothesis.measures):
        if measure not in taken:
            fitting = [test for test, measures in available_tests.items() if measure in measures]
            what = (
                f"no test of {hypothesis.id} has the measure {measure!r}; allowed tests: {_listed(fitting)}"
            )
            raise ValidationError((*place, "measures", index), what)
    for index, test in enumerate(hypothesis.tests):
        if not set(available_tests[test]) & set(hypothesis.measures):
            what = f"{test!r} has no measure of {hypothesis.id}; allowed measures: {_listed(available_tests[test])}"
            raise ValidationError((*place, "tests", index), what)


def _check_known(place: ValuePath, what: str, name: str, allowed: Iterable[str]) -> None:
    if name not in allowed:
        raise ValidationError(place, f"unknown {what} {name!r}; allowed: {_listed(allowed)}")


def _listed(names: Iterable[str]) -> str:
    """Returns the names in quotation marks, because a name may contain commas."""
    return ", ".join(f'"{name}"' for name in names)
