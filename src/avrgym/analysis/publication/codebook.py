"""The codebook of the analysis' tables, for people, for JSON Schema and for Frictionless data packages."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from avrgym.analysis.publication.columns import COLUMNS
from avrgym.analysis.tables import Table
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import NUMBER, TABLES, TEXT, TIME, TRUTH, WHOLE, Column, columns_of

JSON_TYPES = {TEXT: "string", WHOLE: "integer", NUMBER: "number", TRUTH: "boolean", TIME: "string"}


FRICTIONLESS_TYPES = JSON_TYPES | {TIME: "datetime", "any": "any"}


SCHEMA = "https://json-schema.org/draft/2020-12/schema"


PROFILE = "tabular-data-package"


AS_EXPORTED = ("attempts", "answers", "scores", "adverse_events", "functioning")
"""Tables whose rows are those of the export."""


ANY = "any"


UNDESCRIBED = Column("Not described.", ANY)


def describe_column(table: str, column: str, design: Design) -> Column:
    """What a column of a table means; ``UNDESCRIBED`` for one that no codebook knows."""
    if f"{table}.{column}" in COLUMNS:
        return COLUMNS[f"{table}.{column}"]
    if table in AS_EXPORTED and column in TABLES[table]:
        return TABLES[table][column]
    if table == "control_steps" and column.startswith("term_"):
        return columns_of(table, design)[column]
    if table.startswith("paper_table") and column not in ("simulated", "task"):
        return _of_paper_table(column)
    exported = (columns[column] for columns in TABLES.values() if column in columns)
    return COLUMNS.get(column) or next(exported, UNDESCRIBED)


def _of_paper_table(column: str) -> Column:
    condition, _, what = column.rpartition(" ")
    words = "Mean reward" if what == "reward" else "Share of trials that succeeded"
    return Column(f"{words}: {condition}.", NUMBER, "1", empty="no value, or all tasks together")


def codebook(tables: Sequence[Table], design: Design) -> Iterator[dict[str, Any]]:
    """A row for every column of the tables, as the export's codebook has it."""
    for table in tables:
        for column in table.columns:
            yield {
                "table": table.name,
                "column": column,
                **asdict(describe_column(table.name, column, design)),
            }


def json_schema(tables: Sequence[Table], design: Design) -> dict[str, Any]:
    """The rows of each table as JSON Schema, as ``results.json`` has them; all its columns are there."""
    return {
        "$schema": SCHEMA,
        "title": f"Tables of the analysis of {design.title}",
        "type": "object",
        "properties": {table.name: {"type": "array", "items": _row(table, design)} for table in tables},
    }


def _row(table: Table, design: Design) -> dict[str, Any]:
    columns = {name: describe_column(table.name, name, design) for name in table.columns}
    properties = {name: _property(column) for name, column in columns.items()}
    return {
        "type": "object",
        "properties": properties,
        "required": list(columns),
        "additionalProperties": False,
    }


def _property(column: Column) -> dict[str, Any]:
    if column.type == ANY:
        return _described(column)
    kind = JSON_TYPES[column.type]
    return {"type": [kind, "null"] if column.empty else kind, **_described(column)}


def _described(column: Column) -> dict[str, str]:
    unit = f" Unit: {column.unit}." if column.unit not in ("", "1") else ""
    allowed = f" Allowed: {column.allowed}." if column.allowed else ""
    empty = f" Empty: {column.empty}." if column.empty else ""
    return {"description": f"{column.meaning}{unit}{allowed}{empty}"}


def data_package(tables: Sequence[Table], design: Design, notice: str) -> Mapping[str, Any]:
    """The tables as a Frictionless data package (specs.frictionlessdata.io), to lie beside them."""
    return {
        "profile": PROFILE,
        "name": "avrgym-analysis",
        "title": design.title,
        "description": notice,
        "resources": [_resource(table, design) for table in tables],
    }


def _resource(table: Table, design: Design) -> dict[str, Any]:
    fields: list[dict[str, Any]] = []
    for name in table.columns:
        column = describe_column(table.name, name, design)
        required = {} if column.empty else {"constraints": {"required": True}}
        fields.append(
            {"name": name, "type": FRICTIONLESS_TYPES[column.type], **_described(column), **required}
        )
    return {
        "profile": "tabular-data-resource",
        "name": re.sub(r"[^a-z0-9._-]", "-", table.name.lower()),
        "path": f"{table.name}.csv",
        "format": "csv",
        "mediatype": "text/csv",
        "encoding": "utf-8",
        "schema": {"fields": fields, "missingValues": [""]},
    }
