"""Tables of the paper: mean reward and success rate by task and robot. The last row is the success rate over all tasks.

Table I compares simulation with virtual reality for one policy (in the paper: Original). Table II compares policies in
virtual reality.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

from avrgym.analysis.outcomes.condition_outcomes import ConditionOutcome, ObjectiveOutcomeRow
from avrgym.analysis.reading.table_rows import ALL_LABEL
from avrgym.analysis.tables import Table
from avrgym.study.design.design import Design
from avrgym.system import columns
from avrgym.system.columns import describe_columns


@dataclass(frozen=True)
class PaperTableCell:
    """A table cell: mean reward and success rate (0 to 1); ``None`` if unknown."""

    mean_reward: float | None
    success_rate: float | None


EMPTY_TABLE_CELL = PaperTableCell(None, None)


@dataclass(frozen=True)
class PaperTable:
    """A table of the paper, for people or for simulated participants.

    ``cells_by_task``: the cells by task; the last row is over all tasks.
    """

    name: str
    caption: str
    is_simulated: bool
    column_headings: tuple[str, ...]
    cells_by_task: dict[str, tuple[PaperTableCell, ...]]


def _in_vr(row: ObjectiveOutcomeRow) -> PaperTableCell:
    return PaperTableCell(row.reward_mean, row.success_rate)


def _in_simulation(row: ObjectiveOutcomeRow) -> PaperTableCell:
    return PaperTableCell(row.simulation_reward_mean, row.simulation_success_rate)


TABLE_1_CELL_FUNCTIONS: Mapping[str, Callable[[ObjectiveOutcomeRow], PaperTableCell]] = {
    "simulation": _in_simulation,
    "VR": _in_vr,
}
"""Function of each half of Table I, by the name of the half. It returns the cell of a condition."""
PaperTableColumn = tuple[str, str, Callable[[ObjectiveOutcomeRow], PaperTableCell]]
"""A table column: (robot, policy, function that returns the cell of a condition)."""


def make_paper_tables(design: Design, rows: Sequence[ObjectiveOutcomeRow]) -> Iterator[PaperTable]:
    """Yields Table I for each policy, then Table II: first for people, then for simulated participants.

    In Table I, a robot without simulation results has no simulation column.
    """
    for simulated in sorted({row.simulated for row in rows}):
        own = {(row.task, row.robot, row.policy): row for row in rows if row.simulated is simulated}
        for policy in design.policies:
            columns = {
                f"{side} {robot}": (robot, policy, read)
                for (side, read), robot in product(TABLE_1_CELL_FUNCTIONS.items(), design.robots)
                if read is _in_vr
                or any(read(own[task, robot, policy]) != EMPTY_TABLE_CELL for task in design.tasks)
            }
            where = "in simulation and in virtual reality"
            if len(columns) == len(design.robots):
                where = "in virtual reality; it was not evaluated in simulation"
            caption = f"Mean reward (success) of {policy} {where}"
            cells = _cells(design, own, columns.values())
            name = f"paper_table_1_{policy}".replace("/", "_")
            yield PaperTable(name, caption, simulated, tuple(columns), cells)
        caption = "Mean reward (success) of the policies in virtual reality"
        columns = {
            f"{policy} {robot}": (robot, policy, _in_vr)
            for policy, robot in product(design.policies, design.robots)
        }
        cells = _cells(design, own, columns.values())
        yield PaperTable("paper_table_2", caption, simulated, tuple(columns), cells)


def _cells(
    design: Design,
    rows: Mapping[tuple[str, str, str], ObjectiveOutcomeRow],
    columns: Collection[PaperTableColumn],
) -> dict[str, tuple[PaperTableCell, ...]]:
    """Returns the cells by task, then over all tasks. Keys of ``rows``: (task, robot, policy)."""
    return {
        task: tuple(read(rows[task, robot, policy]) for robot, policy, read in columns)
        for task in (*design.tasks, ALL_LABEL)
    }


def make_paper_csv_tables(tables: Sequence[PaperTable]) -> Iterator[Table]:
    """Yields the tables for CSV files, with separate columns for reward and success.

    Rows of people are first, then rows of simulated participants.
    """
    for name in dict.fromkeys(table.name for table in tables):
        own = [table for table in tables if table.name == name]
        heads = [
            f"{column} {metric}" for column in own[0].column_headings for metric in ("reward", "success")
        ]
        values = [
            {"simulated": table.is_simulated, "task": task}
            | dict(
                zip(
                    heads,
                    [value for cell in cells for value in (cell.mean_reward, cell.success_rate)],
                    strict=True,
                )
            )
            for table in own
            for task, cells in table.cells_by_task.items()
        ]
        labels = {name: describe_columns(ConditionOutcome)[name] for name in ("simulated", "task")}
        yield Table(name, labels | {head: _described(head) for head in heads}, values)


def _described(head: str) -> columns.Column:
    condition, _, metric = head.rpartition(" ")
    meaning = "Mean reward" if metric == "reward" else "Share of successful trials"
    return columns.Column(
        f"{meaning}: {condition}.", columns.NUMBER, "1", empty="no value, or all tasks together"
    )
