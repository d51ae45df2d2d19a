"""Writes datasets in LeRobot's format v3.0, without video.

Format: https://huggingface.co/docs/lerobot/lerobot-dataset-v3. Colour images are stored as PNG in the table (type
``image`` of the format). Depth and segmentation images are stored as arrays. Needs the extra ``export``.
"""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from avrgym.array_types import BoolArray, NumpyArray
from avrgym.models.scene import SceneConfig
from avrgym.policies.lerobot import ENVIRONMENT_STATE_FEATURE, IMAGE_FEATURE_PREFIX, split_state_features
from avrgym.policies.lerobot import STATE_FEATURE as STATE_FEATURE
from avrgym.system.files import write_atomically
from avrgym.tasks.observation import ObservationSpec, list_value_names, make_robot_measured_mask

DATASET_FORMAT_VERSION = "v3.0"
PARQUET_FILE = "chunk-000/file-000.parquet"
DATA_FILE_PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
"""Path pattern of data files, as in ``info.json`` of the format."""
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles, by their names in the format. Policies with quantile normalisation need q01 and q99."""
UNUSED_STATE_FEATURE = "environment_state"
"""Feature of the values that the robot does not measure, in a dataset with images. Its name has no prefix
``observation``. LeRobot's policies therefore ignore it, and must use the images.
"""
INTERVENTION = "intervention"
"""Feature that marks the frames in which an operator corrected a policy."""
FrameColumns = Mapping[str, NumpyArray]
"""Columns of a table of frames: arrays with one value per frame, by feature name."""


@dataclass(frozen=True)
class DatasetEpisode:
    """One episode of a dataset, with T control steps.

    ``observations`` (T, O) and ``images`` (T, H, W) or (T, H, W, 3), by names such as ``wrist_rgb``, are from the start
    of each step. ``rewards``, ``successes`` and ``forces_on_person_n`` (T,) are from its end. ``episode_columns`` are
    columns of the table of episodes. ``constant_features`` are features that are equal in all frames.
    ``interventions`` (T,): steps in which an operator drove instead of a policy.
    """

    instruction: str
    observations: NumpyArray
    actions: NumpyArray
    rewards: NumpyArray
    successes: BoolArray
    forces_on_person_n: NumpyArray
    images: Mapping[str, NumpyArray] = field(default_factory=dict[str, NumpyArray])
    episode_columns: Mapping[str, Any] = field(default_factory=dict[str, Any])
    constant_features: Mapping[str, bool] = field(default_factory=dict[str, bool])
    interventions: BoolArray | None = None

    def to_features(self, observation: ObservationSpec) -> dict[str, NumpyArray]:
        """Returns the values of all features by LeRobot's names: inputs and outputs of policies, and results."""
        states = split_state_features(observation, np.asarray(self.observations, np.float32))
        if self.images and ENVIRONMENT_STATE_FEATURE in states:
            states[UNUSED_STATE_FEATURE] = states.pop(ENVIRONMENT_STATE_FEATURE)
        count = len(self.actions)
        return {
            **states,
            "action": np.asarray(self.actions, np.float32),
            "next.reward": np.asarray(self.rewards, np.float32),
            "next.done": np.arange(count) == count - 1,
            "next.success": np.asarray(self.successes, bool),
            "next.force_on_person_n": np.asarray(self.forces_on_person_n, np.float32),
            **{name: np.full(count, value) for name, value in self.constant_features.items()},
            **({} if self.interventions is None else {INTERVENTION: np.asarray(self.interventions, bool)}),
            **{f"{IMAGE_FEATURE_PREFIX}{name}": images for name, images in self.images.items()},
        }


class DatasetWriter:
    """Context manager that writes the episodes of one environment into a new folder, one after the other."""

    def __init__(
        self, folder: Path, *, observation: ObservationSpec, scene: SceneConfig, control_hz: int
    ) -> None:
        """Create the folder of the dataset. Raises ``FileExistsError`` if it exists."""
        for name in ("data/chunk-000", "meta/episodes/chunk-000"):
            (folder / name).mkdir(parents=True)
        self._folder, self._observation, self._scene, self._control_hz = (
            folder,
            observation,
            scene,
            control_hz,
        )
        self._tasks: list[str] = []
        self._rows: list[dict[str, Any]] = []
        self._statistics: dict[str, FeatureStatistics] = {}
        self._features: dict[str, dict[str, Any]] = {}
        self._frames = 0
        self._file: pq.ParquetWriter | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Write the metadata of the dataset, unless the ``with`` block raised an error."""
        if self._file is not None:
            self._file.close()
        if error is None:
            self._write_metadata()

    def add_episode(self, episode: DatasetEpisode) -> None:
        """Append an episode of T control steps as T frames to the dataset."""
        if episode.instruction not in self._tasks:
            self._tasks.append(episode.instruction)
        number, length = len(self._rows), len(episode.actions)
        steps = np.arange(length)
        columns: FrameColumns = {
            **episode.to_features(self._observation),
            "timestamp": (steps / self._control_hz).astype(np.float32),
            "frame_index": steps,
            "episode_index": np.full(length, number),
            "index": self._frames + steps,
            "task_index": np.full(length, self._tasks.index(episode.instruction)),
        }
        table = pa.table({name: _arrow(values) for name, values in columns.items()})
        if self._file is None:
            self._file = pq.ParquetWriter(self._folder / "data" / PARQUET_FILE, table.schema)
            self._features = {name: self._feature(name, values) for name, values in columns.items()}
        self._file.write_table(table)
        about: dict[str, Any] = {}
        for name, values in columns.items():
            own = FeatureStatistics(values)
            about |= {f"stats/{name}/{each}": value for each, value in own.to_dict().items()}
            self._statistics[name] = own if name not in self._statistics else self._statistics[name] + own
        self._rows.append(
            {
                "episode_index": number,
                "tasks": [episode.instruction],
                "length": length,
                "dataset_from_index": self._frames,
                "dataset_to_index": self._frames + length,
                "data/chunk_index": 0,
                "data/file_index": 0,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                "success": bool(episode.successes[-1]),
                **episode.episode_columns,
                **about,
            }
        )
        self._frames += length

    def _write_metadata(self) -> None:
        meta = self._folder / "meta"
        pq.write_table(pa.Table.from_pylist(self._rows), meta / "episodes" / PARQUET_FILE)
        pq.write_table(_task_table(self._tasks), meta / "tasks.parquet")
        info = {
            "codebase_version": DATASET_FORMAT_VERSION,
            "robot_type": self._scene.robot.name,
            "total_episodes": len(self._rows),
            "total_frames": self._frames,
            "total_tasks": len(self._tasks),
            "chunks_size": 1000,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": self._control_hz,
            "splits": {"train": f"0:{len(self._rows)}"},
            "data_path": f"data/{DATA_FILE_PATTERN}",
            "video_path": None,
            "features": self._features,
        }
        statistics = {name: found.to_dict() for name, found in self._statistics.items()}
        for name, value in (("info", info), ("stats", statistics)):
            write_atomically(meta / f"{name}.json", json.dumps(value, indent=2).encode() + b"\n")

    def _feature(self, name: str, values: NumpyArray) -> dict[str, Any]:
        """Returns the entry of a feature in ``info.json``: data type, shape and names of components."""
        shape = list(values.shape[1:]) or [1]
        if values.ndim == 4:
            return {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
        measured = make_robot_measured_mask(self._observation)
        named = np.array(list_value_names(self._observation))
        names = {
            STATE_FEATURE: named[measured],
            ENVIRONMENT_STATE_FEATURE: named[~measured],
            UNUSED_STATE_FEATURE: named[~measured],
            "action": np.array(self._scene.action_names),
        }.get(name)
        return {
            "dtype": values.dtype.name,
            "shape": shape,
            "names": None if names is None else names.tolist(),
        }


class FeatureStatistics:
    """Statistics of one feature over frames, for each component; for images, over all pixels of a channel.

    The sum of two objects contains the statistics of the frames of both. Quantiles are exact: numbers are stored, and
    the colours of images are counted.
    """

    def __init__(self, values: NumpyArray) -> None:
        """Summarise the values (T,), (T, k), (T, H, W) or (T, H, W, 3) of a feature."""
        self._count = len(values)
        self._numbers: list[NumpyArray] = []
        self._histogram: NumpyArray | None = None
        self._is_image = values.ndim > 2
        if values.ndim == 4:
            self._histogram = np.stack(
                [np.bincount(values[..., channel].ravel(), minlength=256) for channel in range(3)]
            )
        else:
            self._numbers = [values.reshape(-1, 1) if values.ndim == 3 else values.reshape(len(values), -1)]

    def __add__(self, other: "FeatureStatistics") -> "FeatureStatistics":
        total = FeatureStatistics.__new__(FeatureStatistics)
        total._count = self._count + other._count
        total._numbers = self._numbers + other._numbers
        total._histogram = (
            None
            if self._histogram is None or other._histogram is None
            else self._histogram + other._histogram
        )
        total._is_image = self._is_image
        return total

    def to_dict(self) -> dict[str, Any]:
        """Returns the statistics by their names in the format.

        Each statistic is a list with a value per component, or for images a nested list of shape (channels, 1, 1).
        Colours are from 0 to 1.
        """
        if self._histogram is not None:
            found = _histogram_statistics(self._histogram)
        else:
            found = _number_statistics(np.concatenate(self._numbers).astype(np.float64))
        if self._is_image:
            found = {name: value[:, None, None] for name, value in found.items()}
        return {name: value.tolist() for name, value in found.items()} | {"count": [self._count]}


def _number_statistics(numbers: NumpyArray) -> dict[str, NumpyArray]:
    quantiles = np.quantile(numbers, [*QUANTILES.values()], axis=0)
    return {
        "min": numbers.min(axis=0),
        "max": numbers.max(axis=0),
        "mean": numbers.mean(axis=0),
        "std": numbers.std(axis=0),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def _histogram_statistics(histogram: NumpyArray) -> dict[str, NumpyArray]:
    """Returns statistics (3,) of colours from 0 to 1, from the counts (3, 256) of their 8-bit values."""
    colours = np.arange(256) / 255.0
    counts = histogram / histogram.sum(axis=1, keepdims=True)
    mean = counts @ colours
    ends = np.cumsum(histogram, axis=1)

    def quantile(share: float) -> NumpyArray:
        position = share * (ends[:, -1] - 1)
        below = np.floor(position)
        low, high = (
            colours[(ends <= np.minimum(each, ends[:, -1] - 1)[:, None]).sum(axis=1)]
            for each in (below, below + 1)
        )
        return low + (position - below) * (high - low)

    return {
        "min": quantile(0.0),
        "max": quantile(1.0),
        "mean": mean,
        "std": np.sqrt(np.maximum(counts @ colours**2 - mean**2, 0.0)),
        **{name: quantile(share) for name, share in QUANTILES.items()},
    }


def write_dataset(folder: Path, episodes: Iterable[DatasetEpisode], **about: Any) -> None:
    """Write episodes into a new folder. ``about`` contains the keyword arguments of ``DatasetWriter``."""
    with DatasetWriter(folder, **about) as writer:
        for episode in episodes:
            writer.add_episode(episode)


def _arrow(values: NumpyArray) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    if values.ndim == 4:
        return pa.array([{"bytes": _png(image), "path": None} for image in values], ARROW_IMAGE_TYPE)
    if values.ndim == 3:
        rows = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[2])
        return pa.FixedSizeListArray.from_arrays(rows, values.shape[1])
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


ARROW_IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
"""Arrow type of images in Hugging Face datasets."""


def _png(image: NumpyArray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(image).save(file, "PNG")
    return file.getvalue()


def _task_table(tasks: Sequence[str]) -> pa.Table:
    """Returns the table of task numbers. Its pandas index contains the task texts."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    columns = [
        {"name": name, "field_name": name, "pandas_type": kind, "numpy_type": numpy, "metadata": None}
        for name, (kind, numpy) in kinds.items()
    ]
    described = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": columns,
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": np.arange(len(tasks)), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(described)})
