"""Export a study as LeRobot datasets, one for each environment, see ``learning.lerobot_dataset``."""

from collections.abc import Sequence
from pathlib import Path

from avrgym.learning.lerobot_dataset import DatasetEpisode, DatasetWriter
from avrgym.recording.dataset import make_dataset_episode
from avrgym.robots.registry import find_robot
from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.exported_attempts import ExportedAttempt, group_by_scene
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import TASKS


def write(
    store: StudyStore, completed: Sequence[ExportedAttempt], folder: Path, cameras: Sequence[str] = ()
) -> None:
    """Write completed attempts as LeRobot datasets into a folder. ``cameras``: see ``export_study``."""
    (folder / "README.md").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")
    for name, attempts in group_by_scene(completed).items():
        trial, task = attempts[0].trial, TASKS[attempts[0].trial.task]
        scene = task.make_scene(find_robot(trial.robot))
        with DatasetWriter(
            folder / name,
            observation=task.make_observation_spec(scene),
            scene=scene,
            control_hz=store.design.settings.control_hz,
        ) as writer:
            for exported in attempts:
                writer.add_episode(_episode(exported, cameras))
        (folder / name / "README.md").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")


def _episode(exported: ExportedAttempt, cameras: Sequence[str]) -> DatasetEpisode:
    return make_dataset_episode(
        exported.read_complete_recording(),
        images=exported.render_images(cameras),
        labels={
            f"study/{name}": "" if value is None else value
            for name, value in vars(exported.make_identifiers()).items()
        },
        constants={"simulated": exported.participant.simulated},
    )
