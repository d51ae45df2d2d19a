"""Write the recorded demonstrations of a folder as a LeRobot dataset."""

from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray
from avrgym.learning.lerobot_dataset import DatasetEpisode, write_dataset
from avrgym.models.cameras import list_image_formats, parse_cameras
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.recording.dataset import make_dataset_episode
from avrgym.recording.reader import Recording, RecordingError, read_recording
from avrgym.recording.recorded_world import render_recorded_images
from avrgym.system.files import write_folder_atomically
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import Settings
from avrgym.vr.demonstration.storage import TABLE_FILE, read_episode_table


def write_lerobot_dataset(
    source: Path,
    out: Path,
    cameras: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[str]:
    """Write the completed episodes that the operator marked as a success.

    Returns a message for each omitted episode, with the reason.

    Args:
        source: folder of ``avrgym demonstrate``.
        out: a new folder.
        cameras: cameras whose colour images are rendered from the recorded states, see ``models.cameras``.
        progress: called after each episode, with the number of processed episodes and the total number.

    Raises:
        ValueError: if the folder contains no such episode, or for a camera that the environment lacks.
        FileExistsError: if ``out`` exists.
    """
    if out.exists():
        raise FileExistsError(f"{out} already exists; choose another name")
    if not (source / TABLE_FILE).is_file():
        raise ValueError(f"{source} contains no {TABLE_FILE}; allowed: a folder of `avrgym demonstrate`")
    rows = [
        row
        for row in read_episode_table(source / TABLE_FILE)
        if (row["result"], row["success"]) == ("completed", "True")
    ]
    if not rows:
        raise ValueError(
            f"{source} contains no completed episode with a success mark; press A or Success when the task is done"
        )
    omitted: list[str] = []
    readable: list[tuple[dict[str, str], Settings]] = []
    for row in rows:
        try:
            readable.append((row, _read(source, row).configuration.settings))
        except (OSError, RecordingError) as error:
            omitted.append(f"{row['recording']}: {error}")
    if not readable:
        raise ValueError(f"no recording can be read: {omitted[0]}; restore a backup")
    settings = readable[0][1]
    if any(other != settings for _, other in readable):
        raise ValueError(f"{source} contains recordings with different settings; allowed: equal settings")
    task, scene = find_task_and_scene(rows[0]["environment"], settings)
    chosen = parse_cameras(cameras, scene.robot)

    def episodes() -> Generator[DatasetEpisode]:
        for number, (row, _) in enumerate(readable, start=1):
            recording = _read(source, row)
            frames = [*render_recorded_images(recording, chosen)] if chosen else []
            images = {
                name: np.stack([frame[name] for frame in frames]) for name in list_image_formats(chosen)
            }
            labels = {f"demonstration/{name}": value for name, value in row.items()}
            yield make_dataset_episode(recording, images, labels, {}, _interventions(recording))
            progress(number, len(readable))

    about: dict[str, Any] = {
        "observation": task.make_observation_spec(scene),
        "scene": scene,
        "control_hz": settings.control_hz,
    }
    write_folder_atomically(out, lambda folder: write_dataset(folder, episodes(), **about))
    return omitted


def _read(source: Path, row: dict[str, str]) -> Recording:
    """Returns the recording of the episode in a table row. Raises ``RecordingError`` if it is incomplete."""
    recording = read_recording(source / row["recording"])
    if not recording.is_complete:
        raise RecordingError("the recording is incomplete; allowed: complete recordings")
    return recording


def _interventions(recording: Recording) -> BoolArray:
    """Returns a boolean mask (T,): control steps in which an operator took over from the recording's policy."""
    policy = recording.configuration.policy
    steps = [control for _, control in recording.messages_by_topic["/control"]]
    return np.array(
        [
            policy != OPERATOR_POLICY_NAME and control.driver != policy and not control.idle
            for control in steps
        ]
    )
