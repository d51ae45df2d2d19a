"""Files of figures that scripts measure bit by bit, so that they go on where they stopped."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from avrgym.learning.evaluation import Evaluation
from avrgym.system.files import write_atomically
from papers_results import short

Figures = dict[str, Mapping]


def read(file: Path) -> Figures:
    """All that is measured so far, by name; nothing where there is no file."""
    return msgspec.json.decode(file.read_bytes()) if file.exists() else {}


def add(file: Path, name: str, told: Mapping) -> None:
    """Keep what was measured, and say so."""
    write_atomically(file, msgspec.json.format(msgspec.json.encode(read(file) | {name: told})))
    print(name, told["success_rate"], flush=True)


def chosen(found: Evaluation, figures: Sequence[str]) -> dict[str, object]:
    """Some figures of an evaluation, by name."""
    return {figure: getattr(found, figure) for figure in figures}


def name_of(environment: str, kind: str, group: str) -> str:
    """What the figures of a kind of policy with a group of people are called."""
    return f"{short(environment)} {kind} {group}"


def cells(told: Iterable[Mapping | None], cell: Callable[[Mapping], str]) -> Iterator[str]:
    """Cells of a table, with a dash for what is not measured yet."""
    return ("–" if found is None else cell(found) for found in told)


def success(found: Mapping) -> str:
    """The success of what was measured, in percent with its interval."""
    low, high = (100.0 * end for end in found["success_ci95"])
    return f"{100.0 * found['success_rate']:.1f} % [{low:.0f}, {high:.0f}]"


def success_and_force(found: Mapping) -> str:
    """Its success and the mean force on the person."""
    return f"{success(found)}; {found['force_mean_newton']:.1f} N"
