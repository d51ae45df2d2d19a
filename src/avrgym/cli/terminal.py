"""Print errors, metrics and tables of all commands.

Text is printed without markup: brackets in a title or path have no special meaning. Control characters are escaped.
"""

import json
import os
import stat
import sys
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from avrgym.system.files import write_atomically
from avrgym.system.type_guards import is_array

if TYPE_CHECKING:
    from rich.console import Console

_CONTROLS = {code: f"\\x{code:02x}" for code in (*range(32), *range(127, 160)) if chr(code) not in "\n\t"}
_AS_WIDE_AS_NEEDED = 100_000
EMPTY_CELL_TEXT = "–"
"""Text that a table cell without a value contains."""

JsonFileOption = Annotated[
    Path | None, typer.Option("--json", help="Write the metrics to this file.", metavar="FILE")
]

JobsOption = Annotated[
    int | None,
    typer.Option(
        help="Number of processes; by default one for each core. Does not change the metrics.", min=1
    ),
]


@contextmanager
def report_errors() -> Generator[None]:
    """Context manager: print a user error as one line and exit with code 1."""
    try:
        yield
    except (ValueError, OSError, RuntimeError) as error:
        line = " ".join(f"avrgym: {_error_text(error)}".splitlines())
        typer.echo(escape_control_characters(line, sys.stderr.encoding), err=True)
        raise typer.Exit(1) from error


def _error_text(error: Exception) -> str:
    """Returns the message of an error. For a system error, the message contains the file and the reason."""
    if not isinstance(error, OSError) or error.strerror is None:
        return str(error)
    reason = error.strerror[:1].lower() + error.strerror[1:]
    return reason if error.filename is None else f"{os.fsdecode(error.filename)}: {reason}"


def check_json_file(path: Path | None) -> None:
    """Raises ``ValueError`` if the JSON file cannot be written. Call it before long work.

    The path of a new file, or of an existing regular file, is allowed.
    """
    if path is None:
        return
    if not path.parent.is_dir():
        raise ValueError(f"cannot write {path}: the folder {path.parent} does not exist; create it first")
    if not os.access(path.parent, os.W_OK):
        raise ValueError(
            f"cannot write {path}: the folder {path.parent} is not writable; choose another folder"
        )
    if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
        raise ValueError(f"cannot write {path}: it is not a regular file; choose another name")


def write_json(path: Path | None, metrics: list[dict[str, Any]] | dict[str, Any]) -> None:
    """Write metrics to a JSON file; without a path, do nothing."""
    check_json_file(path)
    if path is not None:
        write_atomically(path, (json.dumps(metrics, indent=2) + "\n").encode())


def escape_control_characters(text: str, encoding: str | None = None) -> str:
    """Returns the text with escaped control characters, except line breaks and tabs.

    Characters that the encoding lacks are also escaped.
    """
    known = encoding or sys.stdout.encoding or "utf-8"
    return text.translate(_CONTROLS).encode(known, "backslashreplace").decode(known)


def print_line(text: str) -> None:
    """Print a line without wrapping. Paths and addresses can then be copied."""
    typer.echo(escape_control_characters(text))


def print_skipped_item(what: str, error: Exception) -> None:
    """Print a line on stderr with the item ``what`` that the command omits, and the reason."""
    reason = (
        str(error) if isinstance(error, ValueError | RuntimeError) else f"{type(error).__name__}: {error}"
    )
    line = " ".join(f"left out  {what}: {reason}".split("\n"))
    typer.echo(escape_control_characters(line, sys.stderr.encoding), err=True)


def print_warning(text: str) -> None:
    """Print ``avrgym: warning:`` and the text on stderr."""
    typer.echo(escape_control_characters(f"avrgym: warning: {text}", sys.stderr.encoding), err=True)


def make_console(width: int | None = None) -> "Console":
    """Returns a console of the package rich, which writes no control characters into files."""
    from rich.console import Console

    is_terminal = sys.stdout.isatty()
    return Console(width=width, force_terminal=is_terminal, markup=False, emoji=False, highlight=False)


def confirm(question: str) -> bool:
    """Ask a yes-no question. Returns whether the answer is yes."""
    return typer.confirm(escape_control_characters(question))


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print rows with the same keys as a table. Cells are not truncated at the width of the terminal."""
    from rich.box import SIMPLE
    from rich.table import Column, Table

    table = Table(*(Column(_cell(name), no_wrap=True) for name in rows[0]), box=SIMPLE)
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    make_console(width=_AS_WIDE_AS_NEEDED).print(table, soft_wrap=True)


def print_region_forces(forces: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> None:
    """Print a table of contact forces in newtons, by row name and body region; see ``RegionStatistics``.

    Regions without contact are omitted.
    """
    rows = [
        {"of": name, "region": region, **figures}
        for name, regions in forces.items()
        for region, figures in regions.items()
        if figures["peak_n"] > 0.0
    ]
    if rows:
        print_table(rows)
    else:
        print_line("There were no contact forces.")


def _cell(value: Any) -> str:
    if value is None:
        return EMPTY_CELL_TEXT if escape_control_characters(EMPTY_CELL_TEXT) == EMPTY_CELL_TEXT else "-"
    if isinstance(value, float):
        return f"{value:.3g}"
    if is_array(value):
        return ", ".join(_cell(item) for item in value)
    return escape_control_characters(str(value)).expandtabs()
