"""A plan to begin with, filled from a study's design, with comments that say what goes where."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import tomlkit

from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import Design
from avrgym.study.plan.plan import FILE, Hypothesis, OfferedPart
from avrgym.study.storage.states import StudyError
from avrgym.system.files import write_new

_TEXT = """\
# The plan of the study {title}.
# Change whatever you like, then freeze it before the first participant: `avrgym study freeze DIR`. From then on
# whatever differs from it is listed as a deviation, and the report tells planned tests from others.

# How many participants shall complete the study, as {design} says.
participants = {participants}

# Why so many; `avrgym study power DIR` simulates what they can show.
sample_size_rationale = ""

# When you stop taking people in, and whether anybody looks at results before.
stopping_rule = {stopping_rule}

# Whatever else shall be settled beforehand.
other = ""

# Tests that are looked at without a hypothesis, for all measures that no hypothesis names. The report does all of the
# tests below; one that stands neither here nor in a hypothesis is listed as a deviation.
# The tests, each with its measures:
{offered}
exploratory = {exploratory}

[exclusion]
# A trial is left out whose person was held still for a larger share of the time in which the robot helped, as
# {design} says.
max_held_share = {max_held_share:.12g}

# Who withdraws, and who does not answer the inclusion questions as {design} requires, enters no test. Further rules in
# words, such as ["Who feels sick is withdrawn by the experimenter."]: you follow them yourself.
further = []

# What you expect: one [[hypotheses]] each. `measures` are the primary measures, `tests` those that judge it. "By
# participant" each participant is one value; "by trial", as in the paper, takes the trials of one participant for
# independent of each other: such a test is judged by participant instead. p is two-sided, corrected over all tests of
# the hypotheses.
{hypotheses}"""
_HYPOTHESIS = """
[[hypotheses]]
id = {id}
text = {text}
measures = {measures}
tests = {tests}
"""


def write_template(
    folder: Path, design: Design, offered: OfferedPart, hypotheses: Sequence[Hypothesis]
) -> Path:
    """Write ``plan.toml`` into a study's folder, with hypotheses to begin with.

    Raises:
        StudyError: when there is one already, which stays.
        OSError: when it cannot be written.
    """
    path = folder / FILE
    try:
        write_new(path, template(design, offered, hypotheses))
    except FileExistsError:
        raise StudyError(f"{path} is there already and stays as it is") from None
    return path


def template(design: Design, offered: OfferedPart, hypotheses: Sequence[Hypothesis]) -> str:
    """The text of a plan that fits a design."""
    return _TEXT.format(
        title=_toml(design.title),
        design=DESIGN,
        participants=design.participants,
        stopping_rule=_toml(
            f"Until {design.participants} participants have completed the study; whoever withdraws is replaced. "
            "Nobody looks at results before."
        ),
        offered="\n".join(
            f"#   {_toml(test)}: {_toml(list(measures))}" for test, measures in offered.items()
        ),
        exploratory=_lines(_not_confirmatory(offered, hypotheses)),
        max_held_share=design.max_held_share,
        hypotheses="".join(_hypothesis(each) for each in hypotheses),
    )


def _not_confirmatory(offered: OfferedPart, hypotheses: Sequence[Hypothesis]) -> list[str]:
    """The tests of which at least one measure belongs to no hypothesis."""
    judged = {(test, measure) for each in hypotheses for test in each.tests for measure in each.measures}
    return [
        test
        for test, measures in offered.items()
        if any((test, measure) not in judged for measure in measures)
    ]


def _hypothesis(hypothesis: Hypothesis) -> str:
    return _HYPOTHESIS.format(
        id=_toml(hypothesis.id),
        text=_toml(hypothesis.text),
        measures=_toml(list(hypothesis.measures)),
        tests=_toml(list(hypothesis.tests)),
    )


def _lines(values: Sequence[str]) -> str:
    """An array with a line for each value."""
    return "\n".join(["[", *(f"    {_toml(value)}," for value in values), "]"])


def _toml(value: Any) -> str:
    toml: Any = tomlkit  # whose types are known only in part
    return str(toml.item(value).as_string())
