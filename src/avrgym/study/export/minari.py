"""Export a study as Minari datasets (https://minari.farama.org) in HDF5; one dataset for each environment.

To open a dataset, set ``MINARI_DATASETS_PATH`` to the folder and call
``minari.load_dataset("avrgym/FeedingJaco/study-v0")``. Recordings contain no observation after the last step, so the
last observation is repeated. All trials are truncated, because they end after a fixed time.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import numpy as np

from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.exported_attempts import ExportedAttempt, group_by_scene
from avrgym.study.storage.store import StudyStore

MINARI_VERSION = "0.5.0"
"""Version of Minari's dataset format."""


def write(store: StudyStore, completed: Sequence[ExportedAttempt], folder: Path) -> None:
    """Write completed attempts as Minari datasets into a folder."""
    (folder / "README.txt").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")
    for scene, attempts in group_by_scene(completed).items():
        data = folder / "avrgym" / scene / "study-v0" / "data"
        data.mkdir(parents=True)
        with h5py.File(data / "main_data.hdf5", "x", track_order=True) as file:
            shapes = [
                _write_episode(file.create_group(f"episode_{number}"), number, exported)
                for number, exported in enumerate(attempts)
            ]
        described = _metadata(store, scene, attempts, shapes)
        (data / "metadata.json").write_text(json.dumps(described, indent=2) + "\n", encoding="utf-8")


def _write_episode(group: h5py.Group, number: int, exported: ExportedAttempt) -> tuple[int, int, int]:
    """Write one attempt as an episode. Returns the number of steps, and the sizes of observation and action."""
    steps = [control for _, control in exported.read_control_steps()]
    observations = np.array([control.observation for control in steps])
    actions = np.array([control.action for control in steps], np.float32)
    group["observations"] = np.concatenate([observations, observations[-1:]])
    group["actions"] = actions
    group["rewards"] = np.array([control.reward for control in steps])
    group["terminations"] = np.zeros(len(steps), bool)
    group["truncations"] = np.arange(1, len(steps) + 1) == len(steps)
    succeeded = [control.success for control in steps]
    group["infos/success"] = np.array(succeeded[:1] + succeeded)
    group.attrs.update({"id": number, "seed": exported.trial.seed, "total_steps": len(steps)})
    for name, value in vars(exported.make_identifiers()).items():
        group.attrs[name] = "" if value is None else value
    return len(steps), observations.shape[1], actions.shape[1]


def _metadata(
    store: StudyStore, scene: str, attempts: Sequence[ExportedAttempt], shapes: Sequence[tuple[int, int, int]]
) -> dict[str, Any]:
    _, observed, acted = shapes[0]
    policies = dict.fromkeys(exported.trial.policy for exported in attempts)
    return {
        "dataset_id": f"avrgym/{scene}/study-v0",
        "data_format": "hdf5",
        "total_episodes": len(attempts),
        "total_steps": sum(steps for steps, _, _ in shapes),
        "observation_space": _box(observed, float("inf"), "float64"),
        "action_space": _box(acted, 1.0, "float32"),
        "env_spec": gymnasium.spec(attempts[0].trial.environment).to_json(),
        "algorithm_name": ", ".join(policies),
        "description": f"{store.design.title}. {PRIVACY_NOTICE}",
        "minari_version": MINARI_VERSION,
    }


def _box(size: int, bound: float, dtype: str) -> str:
    """Returns a Gymnasium ``Box`` space in Minari's JSON format."""
    ends = {"low": [-bound] * size, "high": [bound] * size}
    return json.dumps({"type": "Box", "dtype": dtype, "shape": [size], **ends})
