"""All that a simulation of power gives, for a file and for the terminal."""

from collections.abc import Sequence
from dataclasses import asdict
from math import ceil
from typing import Any

from avrgym.analysis.power.answers import Assumptions
from avrgym.analysis.power.power import GOALS, PowerRow, needed
from avrgym.analysis.power.words import power_sentences
from avrgym.analysis.statistics.families import PARTICIPANT
from avrgym.study.design.design import Design


def summary(design: Design, assumptions: Assumptions, rows: Sequence[PowerRow], seed: int) -> dict[str, Any]:
    """Assumptions, figures, needed numbers of participants and words, as JSON has them."""
    return {
        "title": design.title,
        "seed": seed,
        "assumptions": asdict(assumptions),
        "power": [asdict(row) for row in rows],
        "needed": _needed(assumptions, rows),
        "words": list(power_sentences(assumptions, rows, design.participants)),
    }


def _needed(assumptions: Assumptions, rows: Sequence[PowerRow]) -> list[dict[str, Any]]:
    """How many must complete the study, and be taken in for that; ``None`` where no number that was simulated does."""
    found: list[dict[str, Any]] = []
    for effect, test, measure in _tests(rows):
        for goal in GOALS:
            number = needed(rows, effect, test, measure, goal)
            taken_in = None if number is None else ceil(number / (1.0 - assumptions.dropout))
            found.append(
                {"effect": effect, "test": test, "measure": measure, "power": goal}
                | {"participants": number, "taken_in": taken_in}
            )
    return found


def printed(rows: Sequence[PowerRow]) -> list[dict[str, str]]:
    """A row for each effect, test and measure: corrected power by number of participants, then the numbers needed."""
    sizes = sorted({row.participants for row in rows if row.effect})
    return [
        {"effect": f"{effect:g}", "test": _shown(test), "measure": measure}
        | {f"n={size}": _power(rows, effect, test, measure, size) for size in sizes}
        | {f"{100 * goal:.0f} % at": _number(rows, effect, test, measure, goal) for goal in GOALS}
        for effect, test, measure in _tests(rows)
    ]


def _shown(test: str) -> str:
    return test if test.endswith(PARTICIPANT) else f"{test} (not corrected)"


def _tests(rows: Sequence[PowerRow]) -> list[tuple[float, str, str]]:
    return list(dict.fromkeys((row.effect, row.test, row.measure) for row in rows if row.effect))


def _power(rows: Sequence[PowerRow], effect: float, test: str, measure: str, size: int) -> str:
    wanted = effect, test, measure, size
    (row,) = (row for row in rows if (row.effect, row.test, row.measure, row.participants) == wanted)
    half = 50 * (row.corrected_high - row.corrected_low)
    return f"{100 * row.corrected:.0f}±{half:.0f}"


def _number(rows: Sequence[PowerRow], effect: float, test: str, measure: str, goal: float) -> str:
    number = needed(rows, effect, test, measure, goal)
    most = max(row.participants for row in rows)
    return f"over {most}" if number is None else str(number)
