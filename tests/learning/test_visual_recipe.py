"""Tests of the recipe of policies with vision."""

from dataclasses import replace
from pathlib import Path

import pytest

from avrgym.learning import configuration, training, visual_recipe
from avrgym.learning.configuration import VisualConfiguration, read_configuration
from avrgym.learning.hyperparameters import VISUAL_HYPERPARAMETERS
from avrgym.policies.trained_policies import load_policy
from avrgym.tasks.camera_images import find_rendering_error

FEEDING = "avrgym/FeedingJaco-v1"
SMALL = VisualConfiguration(environment=FEEDING, steps=16, num_envs=4, seed=3)
"""Two updates of four episodes with two control steps."""


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    short = replace(
        VISUAL_HYPERPARAMETERS, episode_steps=2, gradient_steps=3, final_round_gradient_steps=3, batch_size=4
    )
    for module in (visual_recipe, configuration):
        monkeypatch.setattr(module, "VISUAL_HYPERPARAMETERS", short)
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)


@pytest.mark.slow
@pytest.mark.skipif(find_rendering_error() is not None, reason="no graphics library renders here")
@pytest.mark.usefixtures("small", "one_thread")
def test_an_interrupted_training_of_vision_gets_the_same_weights(tmp_path: Path) -> None:
    def stop(progress: training.TrainingProgress) -> None:
        if progress.num_timesteps == 8:
            raise KeyboardInterrupt

    whole = training.train(SMALL, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        training.train(SMALL, tmp_path / "parts", stop)
    assert read_configuration(tmp_path / "parts") == SMALL
    resumed = training.resume_training(tmp_path / "parts")
    assert resumed.parameters_sha256 == whole.parameters_sha256
    assert resumed.metadata.camera == SMALL.camera
    assert resumed.metadata.measured["episodes"] == 1
    saved = load_policy(tmp_path / "whole" / training.POLICY_FILE, FEEDING, 25, 7)
    assert saved.vision is not None
    assert len(saved.vision.estimated_indices) == 11


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"teacher": "oracle"},
            "'oracle' cannot be the teacher of a visual policy; allowed: a feed-forward policy",
        ),
        ({"teacher": "adaptive"}, "'adaptive' cannot be the teacher of a visual policy"),
        ({"camera": "head"}, "unknown camera 'head' of robot Jaco; allowed: wrist, scene"),
        ({"camera": "wrist:64x64:segmentation"}, "allowed kinds of images: rgb, depth"),
    ],
)
def test_an_unsuitable_teacher_or_camera_is_refused(tmp_path: Path, changes: dict[str, str], message: str):
    with pytest.raises(ValueError, match=message):
        training.train(replace(SMALL, **changes), tmp_path / "run")
    assert not (tmp_path / "run").exists()
