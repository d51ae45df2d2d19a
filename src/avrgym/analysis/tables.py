"""Tables as CSV files: each has a header, even without rows."""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from avrgym.analysis.reading.rows import ParticipantRow
from avrgym.analysis.reading.trial_series import TrialSeries
from avrgym.study.export.separated import neutral
from avrgym.system.files import open_new_csv


@dataclass(frozen=True, eq=False)
class Table:
    """Rows of values by column."""

    name: str
    columns: Sequence[str]
    rows: Iterable[Mapping[str, Any]]

    @classmethod
    def of(cls, name: str, kind: type, rows: Sequence[Any]) -> "Table":
        """A table of dataclass rows of one kind."""
        return cls(name, [column.name for column in fields(kind)], [asdict(row) for row in rows])

    def write(self, folder: Path) -> None:
        """Write the table into a folder; text that a spreadsheet would run as a formula gets an apostrophe."""
        with open_new_csv(folder / f"{self.name}.csv") as file:
            writer = csv.writer(file)
            writer.writerow(self.columns)
            writer.writerows([neutral(row[column]) for column in self.columns] for row in self.rows)


def control_steps(
    series: Mapping[tuple[str, int], TrialSeries], participants: Mapping[str, ParticipantRow]
) -> Table:
    """Every control step of every trial with its unweighted reward terms; a term of other tasks is empty."""
    steps = [step for measured in series.values() for step in measured.steps]
    terms = sorted({term for step in steps for term in step.reward_terms})
    columns = [
        "participant", "site", "simulated", "position", "step", "time_s", "reward", "success", "distance_m",
        "force_on_person_n", *(f"term_{term}" for term in terms),
    ]  # fmt: skip
    return Table("control_steps", columns, _steps(series, participants, terms))


def _steps(
    series: Mapping[tuple[str, int], TrialSeries],
    participants: Mapping[str, ParticipantRow],
    terms: Sequence[str],
) -> Iterator[Mapping[str, Any]]:
    for (participant, position), measured in series.items():
        for time_s, step in zip(measured.times_s, measured.steps, strict=True):
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
                **{f"term_{term}": step.reward_terms.get(term) for term in terms},
            }
