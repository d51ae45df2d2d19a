"""Summary of a power simulation: as JSON, as a table for the terminal, and as text."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from math import ceil
from typing import Any

from avrgym.analysis.power.power_simulation import ALPHA, TARGET_POWERS, PowerRow, find_required_participants
from avrgym.analysis.power.simulated_studies import PowerAssumptions
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS, PARTICIPANT_UNIT
from avrgym.study.design.design import Design


def make_power_summary(
    design: Design, assumptions: PowerAssumptions, rows: Sequence[PowerRow], seed: int
) -> dict[str, Any]:
    """Returns assumptions, power, required numbers of participants and text, for a JSON file."""
    return {
        "title": design.title,
        "seed": seed,
        "assumptions": asdict(assumptions),
        "power": [asdict(row) for row in rows],
        "needed": _required_numbers(assumptions, rows),
        "words": list(describe_power(assumptions, rows, design.participants)),
    }


def _required_numbers(assumptions: PowerAssumptions, rows: Sequence[PowerRow]) -> list[dict[str, Any]]:
    """Returns the required numbers of participants: completed (``participants``) and enrolled (``taken_in``).

    Both are ``None`` if no simulated number of participants is sufficient.
    """
    found: list[dict[str, Any]] = []
    for effect, test, measure in _tests(rows):
        for target_power in TARGET_POWERS:
            number = find_required_participants(rows, effect, test, measure, target_power)
            taken_in = None if number is None else ceil(number / (1.0 - assumptions.dropout))
            found.append(
                {"effect": effect, "test": test, "measure": measure, "power": target_power}
                | {"participants": number, "taken_in": taken_in}
            )
    return found


def make_power_table_rows(rows: Sequence[PowerRow]) -> list[dict[str, str]]:
    """Returns a row for each effect, test and measure.

    A row contains the corrected power by number of participants, and the required numbers of participants.
    """
    sizes = sorted({row.participants for row in rows if row.effect})
    return [
        {"effect": f"{effect:g}", "test": _shown(test), "measure": measure}
        | {f"n={size}": _power(rows, effect, test, measure, size) for size in sizes}
        | {
            f"{100 * target_power:.0f} % at": _number(rows, effect, test, measure, target_power)
            for target_power in TARGET_POWERS
        }
        for effect, test, measure in _tests(rows)
    ]


def _shown(test: str) -> str:
    return test if test.endswith(PARTICIPANT_UNIT) else f"{test} (not corrected)"


def _tests(rows: Sequence[PowerRow]) -> list[tuple[float, str, str]]:
    return list(dict.fromkeys((row.effect, row.test, row.measure) for row in rows if row.effect))


def _power(rows: Sequence[PowerRow], effect: float, test: str, measure: str, size: int) -> str:
    wanted = effect, test, measure, size
    (row,) = (row for row in rows if (row.effect, row.test, row.measure, row.participants) == wanted)
    half = 50 * (row.corrected_power_high - row.corrected_power_low)
    return f"{100 * row.corrected_power:.0f}±{half:.0f}"


def _number(rows: Sequence[PowerRow], effect: float, test: str, measure: str, target_power: float) -> str:
    number = find_required_participants(rows, effect, test, measure, target_power)
    maximum = max(row.participants for row in rows)
    return f"over {maximum}" if number is None else str(number)


def describe_power(
    assumptions: PowerAssumptions, rows: Sequence[PowerRow], participants: int
) -> Iterator[str]:
    """Yields sentences about the power of the tests of the first item. The simulation treats all items equally.

    ``participants``: one of the simulated numbers of participants.
    """
    own = [row for row in rows if row.participants == participants and row.measure == rows[0].measure]
    taken_in = ceil(participants / (1.0 - assumptions.dropout))
    yield (
        f"{participants} participants who complete the study (about {taken_in} enrolled if "
        f"{100 * assumptions.dropout:g} % withdraw):"
    )
    yield _min_p_text(participants)
    for row in own:
        if row.effect:
            yield _found(row)
    for row in own:
        if not row.effect:
            yield _false_alarm(row)
    yield "A result that is not significant does not show that there is no effect."


def compute_min_p_value(participants: int) -> float:
    """Returns the smallest possible p value of a Wilcoxon signed-rank test with one value per participant.

    Correction for multiple testing can only increase this p value.
    """
    return min(2.0 / 2.0**participants, 1.0)


def _min_p_text(participants: int) -> str:
    if participants < MIN_PARTICIPANTS:
        return f"No test is computed for fewer than {MIN_PARTICIPANTS} participants."
    minimum = compute_min_p_value(participants)
    words = f"p of a test by participant is at least {minimum:.3g}"
    return f"{words}: no such test can be significant." if minimum >= ALPHA else f"{words}."


def _found(row: PowerRow) -> str:
    verdict = "power is sufficient" if row.corrected_power_low >= 0.8 else _missed(row)
    points = "point" if row.effect == 1 else "points"
    after = (
        f"after correction in {100 * row.corrected_power:.0f} % ({100 * row.corrected_power_low:.0f} to "
        f"{100 * row.corrected_power_high:.0f})"
        if row.test.endswith(PARTICIPANT_UNIT)
        else "not corrected"
    )
    return (
        f"An effect of {row.effect:g} {points} in {row.measure} is significant in {row.test!r} in "
        f"{_share(row.power, row)} of studies, {after}: {verdict}."
    )


def _missed(row: PowerRow) -> str:
    if row.corrected_power_high < 0.5:
        return "power is below 50 %"
    return "power is too low" if row.corrected_power < 0.8 else "power is about 80 %"


def _share(power: float, row: PowerRow) -> str:
    return f"{100 * power:.0f} % ({100 * row.power_low:.0f} to {100 * row.power_high:.0f})"


def _false_alarm(row: PowerRow) -> str:
    return f"Without an effect, {row.test!r} is significant in {_share(row.power, row)} of studies."
