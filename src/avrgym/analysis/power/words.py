"""What so many participants can show, and what they cannot, in words."""

from collections.abc import Iterator, Sequence
from itertools import combinations
from math import ceil

from avrgym.analysis.power.answers import Assumptions
from avrgym.analysis.power.power import ALPHA, PowerRow
from avrgym.analysis.statistics.families import PARTICIPANT
from avrgym.analysis.statistics.subjective import AFTER_TRIAL, asked_at
from avrgym.study.design.design import Design


def in_words(
    design: Design, assumptions: Assumptions, rows: Sequence[PowerRow], participants: int
) -> Iterator[str]:
    """Sentences on a study that so many participants complete, which must be among those of the ``rows``."""
    own = [row for row in rows if row.participants == participants]
    taken_in = ceil(participants / (1.0 - assumptions.dropout))
    yield (
        f"{participants} participants who complete the study (about {taken_in} taken in, if "
        f"{100 * assumptions.dropout:g} % withdraw):"
    )
    yield _smallest_p(design, participants)
    for row in own:
        if row.effect and row.test.endswith(PARTICIPANT):
            yield _found(row)
    for row in own:
        if not row.effect:
            yield _false_alarm(row)
    yield "A test that finds nothing does not show that there is nothing."


def smallest_p(participants: int, tests: int) -> tuple[float, float]:
    """The least p that a signed-rank test of so many values can give, and after Holm over so many tests."""
    least = 2.0 / 2.0**participants
    return min(least, 1.0), min(tests * least, 1.0)


def _smallest_p(design: Design, participants: int) -> str:
    questionnaire = asked_at(design, AFTER_TRIAL)[0]
    pairs = len(list(combinations(design.policies, 2)))
    tests = max(pairs * len(questionnaire.items), len(design.policies))
    least, corrected = smallest_p(participants, tests)
    words = f"By participant p is never below {least:.3g}"
    if least >= ALPHA:
        return f"{words}: no such test can find anything."
    if corrected < ALPHA:
        return f"{words}, the smallest of {tests} after Holm never below {corrected:.3g}."
    return (
        f"{words}, the smallest of {tests} after Holm never below {corrected:.3g}: one effect alone cannot pass, "
        "only all together."
    )


def _found(row: PowerRow) -> str:
    verdict = "shown as a rule" if row.power_holm_low >= 0.8 else _missed(row)
    points = "point" if row.effect == 1 else "points"
    return (
        f"An effect of {row.effect:g} {points} is found by {row.test!r} in {_share(row.power, row)} of studies, after "
        f"Holm in {100 * row.power_holm:.0f} % ({100 * row.power_holm_low:.0f} to {100 * row.power_holm_high:.0f}): "
        f"{verdict}."
    )


def _missed(row: PowerRow) -> str:
    if row.power_holm_high < 0.5:
        return "more often missed than found"
    return "found too seldom to rely on" if row.power_holm < 0.8 else "found in about four of five"


def _share(power: float, row: PowerRow) -> str:
    return f"{100 * power:.0f} % ({100 * row.power_low:.0f} to {100 * row.power_high:.0f})"


def _false_alarm(row: PowerRow) -> str:
    return f"Where there is no effect, {row.test!r} finds one in {_share(row.power, row)} of studies."
