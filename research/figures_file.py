"""Result files of scripts that can be interrupted and continued."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

import msgspec

from avrgym.learning.evaluation import EvaluationResult
from avrgym.system.files import write_atomically
from papers_results import short

Figures = dict[str, Mapping]


def read(file: Path) -> Figures:
    """The results so far, by name; empty without a file."""
    return msgspec.json.decode(file.read_bytes()) if file.exists() else {}


def add(file: Path, name: str, result: Mapping) -> None:
    """Store a result and print its success."""
    write_atomically(file, msgspec.json.format(msgspec.json.encode(read(file) | {name: result})))
    print(name, result["success_rate"], flush=True)


def chosen(found: EvaluationResult, figures: Sequence[str]) -> dict[str, object]:
    """Some figures of an evaluation, by name."""
    return {figure: getattr(found, figure) for figure in figures}


def name_of(environment: str, kind: str, group: str) -> str:
    """The name of a result: environment, kind of policy and group of people."""
    return f"{short(environment)} {kind} {group}"


def cells(results: Iterable[Mapping | None], cell: Callable[[Mapping], str]) -> Iterator[str]:
    """Cells of a table, with a dash for missing results."""
    return ("–" if found is None else cell(found) for found in results)


def success(found: Mapping) -> str:
    """Success in percent with its interval."""
    low, high = (100.0 * end for end in found["success_ci95"])
    return f"{100.0 * found['success_rate']:.1f} % [{low:.0f}, {high:.0f}]"


def success_and_force(found: Mapping) -> str:
    """Success and mean force on the person."""
    return f"{success(found)}; {found['force_mean_newton']:.1f} N"
