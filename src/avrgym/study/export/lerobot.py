"""Export a study as LeRobot datasets, one for each environment, see ``learning.lerobot_dataset``."""

from collections.abc import Sequence
from pathlib import Path

from avrgym.learning.lerobot_dataset import DatasetEpisode, DatasetWriter
from avrgym.recording.dataset import recorded_episode
from avrgym.robots.registry import find_robot
from avrgym.study.export import PRIVACY_NOTICE
from avrgym.study.export.trials import ExportedAttempt, group_by_scene
from avrgym.study.storage.store import Store
from avrgym.tasks.registry import TASKS


def write(
    store: Store, completed: Sequence[ExportedAttempt], folder: Path, cameras: Sequence[str] = ()
) -> None:
    """Write completed attempts as LeRobot datasets into a folder. ``cameras``: see ``export_study``."""
    (folder / "README.md").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")
    for name, attempts in group_by_scene(completed).items():
        trial, task = attempts[0].trial, TASKS[attempts[0].trial.task]
        scene = task.scene(find_robot(trial.robot))
        with DatasetWriter(
            folder / name,
            observation=task.observation(scene),
            scene=scene,
            control_hz=store.design.settings.control_hz,
        ) as writer:
            for exported in attempts:
                writer.add(_episode(exported, cameras))
        (folder / name / "README.md").write_text(PRIVACY_NOTICE + "\n", encoding="utf-8")


def _episode(exported: ExportedAttempt, cameras: Sequence[str]) -> DatasetEpisode:
    return recorded_episode(
        exported.read_complete_recording(),
        images=exported.render_images(cameras),
        labels={
            f"study/{name}": "" if value is None else value
            for name, value in vars(exported.identifiers()).items()
        },
        constants={"simulated": exported.participant.simulated},
    )
