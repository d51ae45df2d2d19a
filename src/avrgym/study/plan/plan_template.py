"""Write a template of ``plan.toml``, filled in from the design, with comments."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import Design
from avrgym.study.plan.analysis_plan import PLAN_FILE, AvailableTests, Hypothesis
from avrgym.study.storage.state_transitions import StudyError
from avrgym.system.files import write_private_file

_TEXT = """\
# The plan of the study {title}.
# Edit it, then freeze it before the first participant: `avrgym study freeze DIR`. Later differences are listed as
# deviations, and the report marks tests as planned or not.

# Number of participants who complete the study, as in {design}.
participants = {participants}

# Reason for the sample size; `avrgym study power DIR` simulates the power.
sample_size_rationale = ""

# When enrolment stops, and whether there are interim analyses.
stopping_rule = {stopping_rule}

# Anything else that is decided in advance.
other = ""

# Exploratory tests: tests without a hypothesis, for all measures that no hypothesis names. The report contains all
# below. A test that is neither listed here nor in a hypothesis is a deviation.
# The tests, each with its measures:
{available_tests}
exploratory = {exploratory}

[exclusion]
# A trial is left out if tracking was lost for a larger share of the time in which the robot helped, as in {design}.
max_held_share = {max_held_share:.12g}

# Participants who withdraw or are excluded by the inclusion questions are in no test. Further rules as text, such as
# ["The experimenter withdraws participants who feel sick."]; you apply them yourself.
further = []

# Rules that the analysis applies to participants, by the quality of their answers after trials, such as
#   [[exclusion.rules]]
#   name = "wrong answers to the attention item"
#   kind = "attention"            # or "straight_lining" with max_share, or "response_time" with min_seconds
#   item = "attention"
#   allowed = [2]
#   max_share = 0.0

# Your hypotheses, one [[hypotheses]] each, with primary measures and tests. In tests "by participant" each participant
# gives one value. Tests "by trial", as in the paper, assume independent trials; their hypotheses are tested by
# participant instead. p is two-sided and corrected over all tests of the hypotheses.
{hypotheses}"""
_HYPOTHESIS = """
[[hypotheses]]
id = {id}
text = {text}
measures = {measures}
tests = {tests}
"""


def write_plan_template(
    folder: Path, design: Design, available_tests: AvailableTests, hypotheses: Sequence[Hypothesis]
) -> Path:
    """Write ``plan.toml`` with suggested hypotheses into a study's folder. Returns the file's path.

    Raises:
        StudyError: if the file exists; it is not changed.
        OSError: if the file cannot be written.
    """
    path = folder / PLAN_FILE
    try:
        write_private_file(path, format_plan_template(design, available_tests, hypotheses))
    except FileExistsError:
        raise StudyError(f"{path} exists already and was not changed; edit it, or remove it first") from None
    return path


def format_plan_template(
    design: Design, available_tests: AvailableTests, hypotheses: Sequence[Hypothesis]
) -> str:
    """Returns the text of ``plan.toml`` for a design, with these hypotheses."""
    return _TEXT.format(
        title=_toml(design.title),
        design=DESIGN,
        participants=design.participants,
        stopping_rule=_toml(
            f"Until {design.participants} participants have completed the study; withdrawn participants are replaced. "
            "No interim analyses."
        ),
        available_tests="\n".join(
            f"#   {_toml(test)}: {_toml(list(measures))}" for test, measures in available_tests.items()
        ),
        exploratory=_lines(_not_confirmatory(available_tests, hypotheses)),
        max_held_share=design.max_held_share,
        hypotheses="".join(_hypothesis(each) for each in hypotheses),
    )


def _not_confirmatory(available_tests: AvailableTests, hypotheses: Sequence[Hypothesis]) -> list[str]:
    """Returns the tests with at least one measure that is in no hypothesis."""
    confirmatory = {
        (test, measure) for each in hypotheses for test in each.tests for measure in each.measures
    }
    return [
        test
        for test, measures in available_tests.items()
        if any((test, measure) not in confirmatory for measure in measures)
    ]


def _hypothesis(hypothesis: Hypothesis) -> str:
    return _HYPOTHESIS.format(
        id=_toml(hypothesis.id),
        text=_toml(hypothesis.text),
        measures=_toml(list(hypothesis.measures)),
        tests=_toml(list(hypothesis.tests)),
    )


def _lines(values: Sequence[str]) -> str:
    """Returns an array in TOML with a line for each value."""
    return "\n".join(["[", *(f"    {_toml(value)}," for value in values), "]"])


def _toml(value: Any) -> str:
    toml: Any = tomlkit  # incomplete type hints
    return str(toml.item(value).as_string())
