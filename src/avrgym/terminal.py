"""What all commands share: errors, figures and tables on the terminal."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Column, Table

from avrgym.files import write_whole

console = Console()
TABLE_WIDTH = 160

JsonFile = Annotated[
    Path | None, typer.Option("--json", help="Write the figures to this file.", metavar="FILE")
]


@contextmanager
def plain_errors() -> Iterator[None]:
    """Turn an error that the user can mend into one clear line and exit code 1."""
    try:
        yield
    except (ValueError, OSError, RuntimeError) as error:
        typer.echo(f"avrgym: {error}", err=True)
        raise typer.Exit(1) from error


def check_folder(json_file: Path | None) -> None:
    """Raise ``ValueError`` before long work whose figures could not be written."""
    if json_file is not None and not json_file.parent.is_dir():
        raise ValueError(f"cannot write {json_file}: there is no folder {json_file.parent}")


def write_json(path: Path | None, figures: list[dict[str, Any]] | dict[str, Any]) -> None:
    """Write figures to the file that was asked for, if one was."""
    if path is not None:
        write_whole(path, (json.dumps(figures, indent=2) + "\n").encode())


def say(text: str) -> None:
    """Print a line as it is, so that paths and addresses can be copied."""
    console.print(text, soft_wrap=True, highlight=False)


def print_table(rows: list[dict[str, Any]]) -> None:
    """Print rows of equal keys as a table that is never cut at the terminal's edge."""
    table = Table(*(Column(name, no_wrap=True) for name in rows[0]), box=SIMPLE)
    for row in rows:
        table.add_row(*(_cell(value) for value in row.values()))
    Console(width=max(console.width, TABLE_WIDTH)).print(table)


def _cell(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, list | tuple):
        return ", ".join(_cell(item) for item in value)
    return str(value)
