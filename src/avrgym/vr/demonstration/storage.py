"""The folder of a demonstration session: recordings, and a table of its episodes with the operator's success marks."""

import csv
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Literal

TABLE_FILE = "demonstrations.csv"
RECORDINGS_FOLDER = "recordings"

EpisodeResult = Literal["completed", "discarded", "interrupted"]


@dataclass(frozen=True)
class EpisodeRow:
    """One recorded episode.

    Attributes:
        episode: number of the episode, from 1. A discarded episode has the number of the next completed episode.
        attempt: number of the attempt at this episode, from 1.
        recording: path of the episode's recording, relative to the folder.
        environment: id of the environment.
        people: name of the population.
        impairment: the person's impairment.
        sample: number of the sampled person, from 0.
        seed: seed of person and initial state.
        sex: sex of the body model.
        torso_height_m: the person's torso height in metres.
        result: ``completed``, ``discarded`` or ``interrupted``.
        success: whether the operator marked the episode as a success.
        task_success: whether the task's own criterion was met.
        steps: number of control steps.
        driven_by: ``operator``, ``demonstrator`` or ``simulated``.
    """

    episode: int
    attempt: int
    recording: str
    environment: str
    people: str
    impairment: str
    sample: int
    seed: int
    sex: str
    torso_height_m: float
    result: EpisodeResult
    success: bool
    task_success: bool
    steps: int
    driven_by: str


class DemonstrationFolder:
    """Table and recordings of the demonstrations of one environment. New episodes are added to an existing folder."""

    def __init__(self, folder: Path, environment: str) -> None:
        """Reads an existing table.

        Raises:
            ValueError: if the folder contains other files, or demonstrations of another environment.
        """
        self.folder, self._table = folder, folder / TABLE_FILE
        if folder.exists() and not self._table.is_file() and any(folder.iterdir()):
            raise ValueError(f"{folder} contains other files; give --out an empty or new folder")
        self.episode_rows = read_episode_table(self._table) if self._table.is_file() else []
        others = {row["environment"] for row in self.episode_rows} - {environment}
        if others:
            raise ValueError(
                f"{folder} contains demonstrations of {', '.join(sorted(others))}; give --out another folder"
            )
        folder.mkdir(parents=True, exist_ok=True)
        if not self._table.is_file():
            with self._table.open("w", newline="", encoding="utf-8") as file:
                csv.writer(file).writerow([field.name for field in fields(EpisodeRow)])

    @property
    def recordings_folder(self) -> Path:
        """The subfolder that contains the recordings of all episodes."""
        return self.folder / RECORDINGS_FOLDER

    @property
    def num_samples(self) -> int:
        """Number of people that were sampled for the episodes in the table."""
        return max((int(row["sample"]) + 1 for row in self.episode_rows), default=0)

    def count_episodes(self, result: EpisodeResult, *, success: bool | None = None) -> int:
        """Returns the number of episodes with this result.

        ``success``: if given, only episodes with this mark of the operator are included.
        """
        marks = {None: ("True", "False"), True: ("True",), False: ("False",)}[success]
        return sum(row["result"] == result and row["success"] in marks for row in self.episode_rows)

    def append_episode(self, row: EpisodeRow) -> None:
        """Add an episode to the end of the table. Raises ``OSError`` if it cannot be written."""
        values = {name: str(value) for name, value in asdict(row).items()}
        with self._table.open("a", newline="", encoding="utf-8") as file:
            csv.writer(file).writerow(values.values())
        self.episode_rows.append(values)


def read_episode_table(table: Path) -> list[dict[str, str]]:
    """Returns the rows of a table: texts by column. Raises ``ValueError`` if the table has other columns."""
    with table.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows, columns = list(reader), [field.name for field in fields(EpisodeRow)]
        if reader.fieldnames != columns:
            raise ValueError(f"{table} has other columns; allowed: {', '.join(columns)}")
    return rows
