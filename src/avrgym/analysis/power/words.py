"""What so many participants can show, and what they cannot, in words."""

from collections.abc import Iterator, Sequence
from math import ceil

from avrgym.analysis.power.answers import Assumptions
from avrgym.analysis.power.power import ALPHA, PowerRow
from avrgym.analysis.statistics.families import LEAST_PARTICIPANTS, PARTICIPANT


def power_sentences(assumptions: Assumptions, rows: Sequence[PowerRow], participants: int) -> Iterator[str]:
    """Sentences on a study that so many participants complete, which must be among those of the ``rows``.

    They are about the first item; the others are imagined alike.
    """
    own = [row for row in rows if row.participants == participants and row.measure == rows[0].measure]
    taken_in = ceil(participants / (1.0 - assumptions.dropout))
    yield (
        f"{participants} participants who complete the study (about {taken_in} taken in, if "
        f"{100 * assumptions.dropout:g} % withdraw):"
    )
    yield _smallest_p(participants)
    for row in own:
        if row.effect:
            yield _found(row)
    for row in own:
        if not row.effect:
            yield _false_alarm(row)
    yield "A test that finds nothing does not show that there is nothing."


def smallest_p(participants: int) -> float:
    """The least p that a signed-rank test of so many values can give, before and after correction."""
    return min(2.0 / 2.0**participants, 1.0)


def _smallest_p(participants: int) -> str:
    if participants < LEAST_PARTICIPANTS:
        return f"Fewer than {LEAST_PARTICIPANTS} participants are not tested."
    least = smallest_p(participants)
    words = f"By participant p is never below {least:.3g}"
    return f"{words}: no such test can find anything." if least >= ALPHA else f"{words}."


def _found(row: PowerRow) -> str:
    verdict = "shown as a rule" if row.corrected_low >= 0.8 else _missed(row)
    points = "point" if row.effect == 1 else "points"
    after = (
        f"after correction in {100 * row.corrected:.0f} % ({100 * row.corrected_low:.0f} to "
        f"{100 * row.corrected_high:.0f})"
        if row.test.endswith(PARTICIPANT)
        else "not corrected"
    )
    return (
        f"An effect of {row.effect:g} {points} in {row.measure} is found by {row.test!r} in {_share(row.power, row)} "
        f"of studies, {after}: {verdict}."
    )


def _missed(row: PowerRow) -> str:
    if row.corrected_high < 0.5:
        return "more often missed than found"
    return "found too seldom to rely on" if row.corrected < 0.8 else "found in about four of five"


def _share(power: float, row: PowerRow) -> str:
    return f"{100 * power:.0f} % ({100 * row.power_low:.0f} to {100 * row.power_high:.0f})"


def _false_alarm(row: PowerRow) -> str:
    return f"Where there is no effect, {row.test!r} finds one in {_share(row.power, row)} of studies."
