"""Files of tab-separated values and of JSON, as BIDS has them, and values of tables that no spreadsheet runs."""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""First characters of texts that a spreadsheet would run as a formula."""


def write_rows(path: Path, rows: Iterable[Sequence[Any]]) -> None:
    """Rows with tabs between; what is missing is ``n/a``."""
    with open(path, "x", encoding="utf-8", newline="") as file:
        for row in rows:
            file.write("\t".join(cell(value) for value in row) + "\n")


def cell(value: Any) -> str:
    """A value without tabs and line breaks."""
    text = " ".join(str(neutral(value)).split()) if value is not None else ""
    return text or "n/a"


def neutral(value: Any) -> Any:
    """A value of a table that no spreadsheet runs; truth as ``true`` and ``false``, nothing as empty."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith(FORMULA):
        return f"'{value}"
    return value


def write_json(path: Path, values: Mapping[str, Any]) -> None:
    """Write values as JSON, for people."""
    path.write_text(json.dumps(values, indent=2) + "\n", encoding="utf-8")
