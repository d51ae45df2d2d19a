"""Codebook of the analysis tables: as rows for CSV, as JSON Schema, and as Frictionless data package."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from avrgym.analysis.tables import Table
from avrgym.system.columns import BOOLEAN, INTEGER, NUMBER, TEXT, TIME, Column

JSON_TYPES = {TEXT: "string", INTEGER: "integer", NUMBER: "number", BOOLEAN: "boolean", TIME: "string"}
FRICTIONLESS_TYPES = JSON_TYPES | {TIME: "datetime"}
JSON_SCHEMA_URI = "https://json-schema.org/draft/2020-12/schema"
DATA_PACKAGE_PROFILE = "tabular-data-package"


def make_codebook_rows(tables: Sequence[Table]) -> Iterator[dict[str, Any]]:
    """Yields a row for each column of each table. The format is the same as in the codebook of study exports."""
    for table in tables:
        for name, column in table.columns.items():
            yield {"table": table.name, "column": name, **asdict(column)}


def make_json_schema(tables: Sequence[Table], title: str) -> dict[str, Any]:
    """Returns the JSON Schema of the tables in ``results.json``. Every row has all columns of its table."""
    return {
        "$schema": JSON_SCHEMA_URI,
        "title": f"Tables of the analysis of {title}",
        "type": "object",
        "properties": {table.name: {"type": "array", "items": _row(table)} for table in tables},
    }


def _row(table: Table) -> dict[str, Any]:
    return {
        "type": "object",
        "properties": {name: _property(column) for name, column in table.columns.items()},
        "required": list(table.columns),
        "additionalProperties": False,
    }


def _property(column: Column) -> dict[str, Any]:
    kind = JSON_TYPES[column.type]
    return {"type": [kind, "null"] if column.empty else kind, **_description(column)}


def _description(column: Column) -> dict[str, str]:
    unit = f" Unit: {column.unit}." if column.unit not in ("", "1") else ""
    allowed = f" Allowed: {column.allowed}." if column.allowed else ""
    empty = f" Empty: {column.empty}." if column.empty else ""
    return {"description": f"{column.meaning}{unit}{allowed}{empty}"}


def make_data_package(tables: Sequence[Table], title: str, description: str) -> Mapping[str, Any]:
    """Returns the descriptor of the tables as a Frictionless data package (specs.frictionlessdata.io)."""
    return {
        "profile": DATA_PACKAGE_PROFILE,
        "name": "avrgym-analysis",
        "title": title,
        "description": description,
        "resources": [_resource(table) for table in tables],
    }


def _resource(table: Table) -> dict[str, Any]:
    return {
        "profile": "tabular-data-resource",
        "name": re.sub(r"[^a-z0-9._-]", "-", table.name.lower()),
        "path": f"{table.name}.csv",
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "schema": {
            "fields": [_field(name, column) for name, column in table.columns.items()],
            "missingValues": [""],
        },
    }


def _field(name: str, column: Column) -> dict[str, Any]:
    required = {} if column.empty else {"constraints": {"required": True}}
    return {"name": name, "type": FRICTIONLESS_TYPES[column.type], **_description(column), **required}
