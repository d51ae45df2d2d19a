"""Export a study as LeRobot datasets (format v3.0) without video; one dataset for each environment.

Format: https://huggingface.co/docs/lerobot/lerobot-dataset-v3. Colour images are stored as PNG in the table (type
``image`` of the format). Depth and segmentation images are stored as arrays.
"""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from PIL import Image

from avrgym.array_types import NumpyArray
from avrgym.robots.registry import find_robot
from avrgym.study.export import NOTICE
from avrgym.study.export.table_files import write_json
from avrgym.study.export.trials import ExportedAttempt, group_by_scene
from avrgym.study.storage.store import Store
from avrgym.tasks.observation import value_names
from avrgym.tasks.registry import TASKS

LEROBOT_VERSION = "v3.0"
FILE = "chunk-000/file-000.parquet"
PATTERN = "chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
"""Path pattern of data files, as in ``info.json`` of the format."""
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles, by their names in the format. Policies with quantile normalisation need q01 and q99."""
IMAGES = "observation.images"
"""Prefix of image features."""
Columns = Mapping[str, NumpyArray]
"""Values of all frames, by feature."""


def write(
    store: Store, completed: Sequence[ExportedAttempt], folder: Path, cameras: Sequence[str] = ()
) -> None:
    """Write completed attempts as LeRobot datasets into a folder. ``cameras``: see ``export_study``."""
    (folder / "README.md").write_text(NOTICE + "\n", encoding="utf-8")
    for scene, attempts in group_by_scene(completed).items():
        _write_dataset(attempts, folder / scene, cameras)


def _write_dataset(attempts: Sequence[ExportedAttempt], folder: Path, cameras: Sequence[str]) -> None:
    for place in ("data/chunk-000", "meta/episodes/chunk-000"):
        (folder / place).mkdir(parents=True)
    (folder / "README.md").write_text(NOTICE + "\n", encoding="utf-8")
    tasks = list(dict.fromkeys(_task(exported) for exported in attempts))
    episodes: list[Columns] = []
    rows: list[dict[str, Any]] = []
    start = 0
    for number, exported in enumerate(attempts):
        columns = _columns(exported, number, start, tasks.index(_task(exported)), cameras)
        length = len(columns["index"])
        episodes.append(columns)
        rows.append(_episode(exported, columns, number, start, length))
        start += length
    whole = {name: np.concatenate([columns[name] for columns in episodes]) for name in episodes[0]}
    pq.write_table(pa.table({name: _arrow(values) for name, values in whole.items()}), folder / "data" / FILE)
    pq.write_table(pa.Table.from_pylist(rows), folder / "meta" / "episodes" / FILE)
    pq.write_table(_task_table(tasks), folder / "meta" / "tasks.parquet")
    write_json(folder / "meta" / "info.json", _info(attempts, whole, len(tasks)))
    write_json(folder / "meta" / "stats.json", {name: statistics(values) for name, values in whole.items()})


def _task(exported: ExportedAttempt) -> str:
    return f"The {exported.trial.robot} helps a person: {exported.trial.task}."


def _columns(
    exported: ExportedAttempt, episode: int, start: int, task: int, cameras: Sequence[str]
) -> Columns:
    """Returns the values of one attempt, by feature.

    Shapes: (steps,), (steps, size), and (steps, H, W) or (steps, H, W, 3) for images.
    """
    steps = [control for _, control in exported.control_steps()]
    numbers = np.arange(len(steps))
    return {
        "observation.state": np.array([control.observation for control in steps], np.float32),
        "action": np.array([control.action for control in steps], np.float32),
        "next.reward": np.array([control.reward for control in steps], np.float32),
        "next.done": numbers == len(steps) - 1,
        "next.success": np.array([control.success for control in steps], bool),
        "simulated": np.full(len(steps), exported.participant.simulated),
        "timestamp": (numbers / exported.store.design.settings.control_hz).astype(np.float32),
        "frame_index": numbers,
        "episode_index": np.full(len(steps), episode),
        "index": start + numbers,
        "task_index": np.full(len(steps), task),
        **{f"{IMAGES}.{name}": images for name, images in exported.images(cameras).items()},
    }


def _episode(
    exported: ExportedAttempt, columns: Columns, number: int, start: int, length: int
) -> dict[str, Any]:
    about = {
        f"stats/{feature}/{name}": value
        for feature, values in columns.items()
        for name, value in statistics(values).items()
    }
    labels = {
        f"study/{name}": "" if value is None else value
        for name, value in vars(exported.identifiers()).items()
    }
    return {
        "episode_index": number,
        "tasks": [_task(exported)],
        "length": length,
        "dataset_from_index": start,
        "dataset_to_index": start + length,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
        **labels,
        **about,
    }


def statistics(values: NumpyArray) -> dict[str, list[float]]:
    """Returns the statistics of a feature over all frames, by name, with a value for each component.

    Quantiles are computed over all frames. The mean of the episodes' quantiles would have a range that is too small.
    """
    if values.ndim > 2:
        return _image_statistics(values)
    numbers = values.reshape(len(values), -1).astype(np.float64)
    return {
        "min": numbers.min(axis=0).tolist(),
        "max": numbers.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(numbers)],
        **{name: np.quantile(numbers, share, axis=0).tolist() for name, share in QUANTILES.items()},
    }


def _image_statistics(images: NumpyArray) -> dict[str, Any]:
    """Returns the statistics of images (frames, H, W) or (frames, H, W, 3) for each channel.

    Each statistic is a nested list of shape (channels, 1, 1). Colours are from 0 to 1.
    """
    scale = 255.0 if images.dtype == np.uint8 else 1.0
    channels = images.reshape(-1, images.shape[3] if images.ndim == 4 else 1) / scale
    values = {
        "min": channels.min(axis=0),
        "max": channels.max(axis=0),
        "mean": channels.mean(axis=0),
        "std": channels.std(axis=0),
        **{name: np.quantile(channels, share, axis=0) for name, share in QUANTILES.items()},
    }
    return {name: value[:, None, None].tolist() for name, value in values.items()} | {"count": [len(images)]}


def _arrow(values: NumpyArray) -> pa.Array:
    if values.ndim == 1:
        return pa.array(values)
    if values.ndim == 4:
        return pa.array([{"bytes": _png(image), "path": None} for image in values], IMAGE_TYPE)
    if values.ndim == 3:
        rows = pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[2])
        return pa.FixedSizeListArray.from_arrays(rows, values.shape[1])
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
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


def _info(attempts: Sequence[ExportedAttempt], whole: Columns, tasks: int) -> dict[str, Any]:
    names = _names(attempts[0])
    return {
        "codebase_version": LEROBOT_VERSION,
        "robot_type": attempts[0].trial.robot,
        "total_episodes": len(attempts),
        "total_frames": len(whole["index"]),
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": attempts[0].store.design.settings.control_hz,
        "splits": {"train": f"0:{len(attempts)}"},
        "data_path": f"data/{PATTERN}",
        "video_path": None,
        "features": {name: _feature(values, names.get(name)) for name, values in whole.items()},
    }


def _feature(values: NumpyArray, names: Sequence[str] | None) -> dict[str, Any]:
    shape = list(values.shape[1:]) or [1]
    if values.ndim == 4:
        return {"dtype": "image", "shape": shape, "names": ["height", "width", "channels"]}
    fit = names is not None and len(names) == shape[0]
    return {"dtype": values.dtype.name, "shape": shape, "names": list(names) if names and fit else None}


def _names(exported: ExportedAttempt) -> dict[str, list[str]]:
    """Returns the component names of observation and action, by feature."""
    task = TASKS[exported.trial.task]
    scene = task.scene(find_robot(exported.trial.robot))
    return {"observation.state": value_names(task.observation(scene)), "action": list(scene.action_names)}
