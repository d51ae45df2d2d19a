"""Analysis tables, and their CSV files. The file of a table without rows contains only the header."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrgym.analysis.reading.table_rows import ParticipantRow
from avrgym.analysis.reading.trial_time_series import TrialTimeSeries
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import list_table_columns
from avrgym.study.export.table_files import escape_formula
from avrgym.system.columns import NUMBER, Column, describe_columns
from avrgym.system.files import open_new_csv


@dataclass(frozen=True, eq=False)
class Table:
    """A table of the analysis: its name, the description of each column, and rows (values by column name)."""

    name: str
    columns: Mapping[str, Column]
    rows: Iterable[Mapping[str, Any]]

    @classmethod
    def from_rows(cls, name: str, kind: type, rows: Iterable[object]) -> "Table":
        """Returns a table from ``rows``, which are instances of the dataclass ``kind``."""
        return cls(name, describe_columns(kind), [vars(row) for row in rows])

    def write(self, folder: Path) -> None:
        """Write the table as a CSV file into a folder.

        If a spreadsheet could execute a text as a formula, the text starts with an apostrophe in the file.
        """
        with open_new_csv(folder / f"{self.name}.csv") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows([escape_formula(row[column]) for column in self.columns] for row in self.rows)


def make_control_steps_table(
    series: Mapping[tuple[str, int], TrialTimeSeries],
    participants: Mapping[str, ParticipantRow],
    design: Design,
) -> Table:
    """Returns the table of all control steps, with unweighted reward terms. The cells of other tasks' terms are
    empty."""
    recorded = {
        f"term_{term}"
        for each in series.values()
        for step in each.control_steps
        for term in step.reward_terms
    }
    labels = ("participant", "site", "simulated", "position")
    metrics = ("step", "time_s", "reward", "success", "distance_m", "force_on_person_n")
    known = list_table_columns("control_steps", design)
    unknown = Column(
        "Reward term of another version, not weighted.", NUMBER, "1", empty="the task has no such term"
    )
    columns = {name: known.get(name, unknown) for name in (*labels, *metrics, *sorted(recorded))}
    return Table("control_steps", columns, _steps(series, participants, sorted(recorded)))


def _steps(
    series: Mapping[tuple[str, int], TrialTimeSeries],
    participants: Mapping[str, ParticipantRow],
    terms: Sequence[str],
) -> Iterator[Mapping[str, Any]]:
    for (participant, position), trial in series.items():
        for time_s, step in zip(trial.times_s, trial.control_steps, strict=True):
            yield {
                "participant": participant,
                "site": participants[participant].site,
                "simulated": participants[participant].simulated,
                "position": position,
                "step": step.step,
                "time_s": time_s,
                "reward": step.reward,
                "success": step.success,
                "distance_m": step.distance_m,
                "force_on_person_n": step.force_on_person_n,
                **{term: step.reward_terms.get(term.removeprefix("term_")) for term in terms},
            }
