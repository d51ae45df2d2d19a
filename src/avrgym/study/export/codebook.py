"""The codebook: a description of every column in the exported tables."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from avrgym.robots.registry import find_robot
from avrgym.study.design.design import Design
from avrgym.study.export import table_rows
from avrgym.system.columns import NUMBER, Column, describe_columns
from avrgym.tasks.registry import TASKS

ROW_TYPES: Mapping[str, type] = {
    "participants": table_rows.ParticipantRow,
    "consents": table_rows.ConsentRow,
    "trials": table_rows.TrialRow,
    "attempts": table_rows.AttemptRow,
    "answers": table_rows.AnswerRow,
    "items": table_rows.ItemRow,
    "scores": table_rows.ScoreRow,
    "scales": table_rows.ScaleRow,
    "log": table_rows.AuditLogRow,
    "control_steps": table_rows.ControlStepRow,
    "events": table_rows.EventRow,
    "adverse_events": table_rows.AdverseEventRow,
    "functioning": table_rows.FunctioningCountRow,
    "functioning_by_person": table_rows.FunctioningRow,
    "notes": table_rows.NoteRow,
    "left_out": table_rows.OmittedAttemptRow,
}
"""The row type of each table, by table name."""
COLUMNS_BY_TABLE: Mapping[str, Mapping[str, Column]] = {
    name: describe_columns(row) for name, row in ROW_TYPES.items()
}
"""The columns of each table, by table and column name, without columns that depend on the design."""
INSTRUMENT_TABLES = ("scores", "scales")
"""Tables that exist only if the study uses validated questionnaires."""
EVENT_AND_NOTE_TABLES = ("events", "adverse_events", "functioning", "functioning_by_person", "notes")
"""Tables of events and of experimenters' texts."""


def list_reward_terms(design: Design) -> list[str]:
    """Returns the names of all reward terms of the design's tasks. ``control_steps`` has a column for each term."""
    return sorted({term for task in design.tasks for term in TASKS[task].reward_weights})


def compute_max_action_size(design: Design) -> int:
    """Returns the largest number of action components of the design's robots.

    The table ``control_steps`` has a column for each component.
    """
    robots = [find_robot(name) for name in design.robots]
    return max(len(robot.list_action_names(arm)) for robot in robots for arm in robot.arms.values())


def list_table_columns(table: str, design: Design) -> Mapping[str, Column]:
    """Returns all columns of a table for a design, by name, in order."""
    if table != "control_steps":
        return COLUMNS_BY_TABLE[table]
    terms = {
        f"term_{term}": Column(
            f"Reward term {term}, not weighted.",
            NUMBER,
            _unit(term),
            empty="the task does not have this term",
        )
        for term in list_reward_terms(design)
    }
    actions = {
        f"action_{joint + 1}": Column(
            f"Action of arm joint {joint + 1}: joint speed divided by its limit.", NUMBER, "1", "−1 to 1"
        )
        for joint in range(compute_max_action_size(design))
    }
    return {**COLUMNS_BY_TABLE[table], **terms, **actions}


def make_codebook_rows(tables: Sequence[str], design: Design) -> Iterator[dict[str, Any]]:
    """Yields one row of the codebook for each column of the tables. ``tables``: table names."""
    for table in tables:
        for name, column in list_table_columns(table, design).items():
            yield {"table": table, "column": name, **asdict(column)}


def _unit(term: str) -> str:
    """Returns the unit of a reward term, from the suffix of its name; ``1`` without a unit suffix."""
    for ending, unit in (("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m"), ("_n", "N")):
        if term.endswith(ending):
            return unit
    return "1"
