"""Short trainings with each example extension: `make soak`."""

from pathlib import Path

import pytest

from helpers.system.example_package import install, train_and_study

STEPS = 20_000


@pytest.mark.parametrize(
    ("task", "robot", "term"),
    [
        ("Handover", "Jaco", "within_reach"),
        ("Feeding", "Fetch", "distance_m"),
    ],
)
def test_extension_supports_training_study_report_and_replay(
    tmp_path: Path, task: str, robot: str, term: str
) -> None:
    install(tmp_path)
    train_and_study(tmp_path, task, robot, term, STEPS, policies=("hold-still",))
