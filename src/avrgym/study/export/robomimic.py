"""Export a study as robomimic demonstrations; one HDF5 file for each environment.

Format: https://robomimic.github.io/docs/datasets/overview.html. Recordings contain no observation after the last
step, so the last entry of ``next_obs`` repeats the last observation. ``flat`` is a second name of ``observation``,
because robomimic uses the name ``flat`` for vector observations.

``create_env_from_metadata`` creates the environments with the module ``old_gym``.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.exported_attempts import ExportedAttempt, group_by_scene
from avrgym.study.storage.store import StudyStore

GYM_ENV_TYPE = 2
"""Environment type of Gym environments in robomimic."""
GYM_ENV_MODULE = "old_gym"
"""Module that Gym imports before it creates an environment."""
OBSERVATION_KEY, OBSERVATION_ALIAS_KEY = "observation", "flat"
"""Names of the observation in a file."""


def write(
    store: StudyStore, completed: Sequence[ExportedAttempt], folder: Path, cameras: Sequence[str] = ()
) -> None:
    """Write completed attempts as robomimic files into a folder. ``cameras``: see ``export_study``."""
    (folder / "README.txt").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")
    for scene, attempts in group_by_scene(completed).items():
        with h5py.File(folder / f"{scene}.hdf5", "x") as file:
            _write_file(file, attempts, cameras)


def _write_file(file: h5py.File, attempts: Sequence[ExportedAttempt], cameras: Sequence[str]) -> None:
    data = file.create_group("data")
    environment = attempts[0].trial.environment
    data.attrs["env_args"] = json.dumps(
        {"env_name": f"{GYM_ENV_MODULE}:{environment}", "type": GYM_ENV_TYPE, "env_kwargs": {}}
    )
    data.attrs["notice"] = PRIVACY_NOTICE
    data.attrs["total"] = sum(
        _write_demonstration(data.create_group(f"demo_{number}"), exported, cameras)
        for number, exported in enumerate(attempts)
    )
    for name, chosen in _masks(attempts).items():
        if any(chosen):
            demonstrations = [f"demo_{number}" for number, is_in in enumerate(chosen) if is_in]
            file[f"mask/{name}"] = np.array(demonstrations, dtype="S")


def _masks(attempts: Sequence[ExportedAttempt]) -> dict[str, list[bool]]:
    """Returns, for each filter key of robomimic, whether each demonstration belongs to the key."""
    practice = [exported.trial.practice for exported in attempts]
    simulated = [exported.participant.simulated for exported in attempts]
    success = [bool(exported.attempt.metrics.success) for exported in attempts]
    policies = dict.fromkeys(exported.trial.policy for exported in attempts)
    return {
        "simulated": simulated,
        "people": [not each for each in simulated],
        "practice": practice,
        "not_practice": [not each for each in practice],
        "success": success,
        "failure": [not each for each in success],
        **{
            f"policy_{name.replace('/', '_')}": [e.trial.policy == name for e in attempts]
            for name in policies
        },
    }


def _write_demonstration(group: h5py.Group, exported: ExportedAttempt, cameras: Sequence[str]) -> int:
    """Write one attempt as a demonstration. Returns the number of samples."""
    steps = [control for _, control in exported.read_control_steps()]
    observations = np.array([control.observation for control in steps])
    for name, value in vars(exported.make_identifiers()).items():
        group.attrs[name] = "" if value is None else value
    group.attrs["seed"] = exported.trial.seed
    group.attrs["num_samples"] = len(steps)
    group["actions"] = np.array([control.action for control in steps])
    group["rewards"] = np.array([control.reward for control in steps])
    group["dones"] = np.arange(1, len(steps) + 1) == len(steps)
    group["success"] = np.array([control.success for control in steps])
    group[f"obs/{OBSERVATION_KEY}"] = observations
    group[f"next_obs/{OBSERVATION_KEY}"] = np.concatenate([observations[1:], observations[-1:]])
    for name, images in exported.render_images(cameras).items():
        group[f"obs/{name}"] = images
        group[f"next_obs/{name}"] = np.concatenate([images[1:], images[-1:]])
    for place in ("obs", "next_obs"):
        group[f"{place}/{OBSERVATION_ALIAS_KEY}"] = group[f"{place}/{OBSERVATION_KEY}"]
    return len(steps)
