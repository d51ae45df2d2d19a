"""Write tables as CSV, as TSV and as JSON."""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from avrgym.system.files import open_new_csv
from avrgym.system.type_guards import is_table

FORMULA_PREFIXES = ("=", "+", "-", "@", "\t", "\r", "\n")
"""First characters of texts that a spreadsheet may execute as a formula."""


def write_csv(path: Path, rows: Iterable[Any], columns: Iterable[str] = ()) -> None:
    """Write a new CSV file. A row is a dataclass instance or a mapping. All rows must have the same columns.

    ``columns``: header of a table without rows.
    """
    heading = list(columns)
    with open_new_csv(path) as file:
        writer = csv.writer(file)
        for number, row in enumerate(map(extract_row_values, rows)):
            if number == 0:
                heading = []
                writer.writerow(row)
            writer.writerow(escape_formula(value) for value in row.values())
        if heading:
            writer.writerow(heading)


def extract_row_values(row: object) -> Mapping[str, Any]:
    """Returns the values of a row, by column name."""
    return row if is_table(row) else vars(row)


def write_tsv(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    """Write a new file of tab-separated values (TSV). A missing value becomes ``n/a``."""
    with open(path, "x", encoding="utf-8", newline="") as file:
        for row in rows:
            file.write("\t".join(format_tsv_cell(value) for value in row) + "\n")


def format_tsv_cell(value: Any) -> str:
    """Returns a value as text without tabs and line breaks; ``n/a`` for ``None`` and empty text."""
    text = " ".join(str(escape_formula(value)).split()) if value is not None else ""
    return text or "n/a"


def escape_formula(value: Any) -> Any:
    """Returns the value for a table. Booleans become ``true`` or ``false``; possible formulas get an apostrophe."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith(FORMULA_PREFIXES):
        return f"'{value}"
    return value


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values to a file as indented JSON."""
    path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
