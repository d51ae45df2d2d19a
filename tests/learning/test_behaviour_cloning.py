"""Behaviour cloning: policies follow demonstrations, and corrections count as much as demonstrations."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.learning import behaviour_cloning
from avrgym.learning.behaviour_cloning import clone, read_episodes
from avrgym.learning.lerobot_dataset import DatasetEpisode, write_dataset
from avrgym.policies.actors import Actor
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.settings import DEFAULT_SETTINGS

ENVIRONMENT = "avrgym/FeedingJaco-v1"
INPUT = 3
"""Number of the observed value that the demonstrated actions repeat."""


def episode(length: int, seed: int, marks: np.ndarray | None = None) -> DatasetEpisode:
    """An episode whose actions repeat one observed value. Steps without a mark have the opposite action."""
    observations = np.random.default_rng(seed).normal(size=(length, 25))
    sign = 1.0 if marks is None else np.where(marks, 1.0, -1.0)
    actions = np.repeat((sign * 0.3 * observations[:, INPUT])[:, None], 7, axis=1)
    zeros = np.zeros(length)
    return DatasetEpisode(
        *("Help.", observations, actions, zeros, zeros > 0, zeros),
        interventions=np.zeros(length, bool) if marks is None else marks,
    )


def dataset(folder: Path, episodes: list[DatasetEpisode], environment: str = ENVIRONMENT) -> Path:
    task, scene = find_task_and_scene(environment, DEFAULT_SETTINGS)
    about: dict[str, Any] = {
        "observation": task.make_observation_spec(scene),
        "scene": scene,
        "control_hz": 10,
    }
    write_dataset(folder, episodes, **about)
    return folder


def test_corrections_count_as_much_as_demonstrations_and_the_policys_own_steps_do_not(tmp_path: Path) -> None:
    marks = np.array([False, False, True, True, False])
    shown = dataset(tmp_path / "shown", [episode(8, 0), episode(4, 1)])
    corrected = dataset(tmp_path / "corrected", [episode(5, 2, marks)])
    read = read_episodes(ENVIRONMENT, [shown, corrected])
    assert read.observations.shape == (8, 3, 25)
    np.testing.assert_array_equal(read.weights[:, 0], 1.0)
    np.testing.assert_array_equal(read.weights[:, 1], [1, 1, 1, 1, 0, 0, 0, 0])
    np.testing.assert_array_equal(read.weights[:, 2], [0, 0, 6, 6, 0, 0, 0, 0])
    np.testing.assert_allclose(read.observations[:5, 2], episode(5, 2).observations, rtol=1e-6)
    assert read_episodes(ENVIRONMENT, [shown], max_episodes=1).actions.shape == (8, 1, 7)


def test_a_clone_follows_demonstrations_and_the_same_seed_gives_the_same_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(behaviour_cloning, "GRADIENT_STEPS", 150)
    marks = np.arange(40) % 4 == 0
    folder = dataset(tmp_path / "d", [episode(40, 0, marks), *[episode(40, each) for each in range(1, 12)]])
    read = read_episodes(ENVIRONMENT, [folder])
    losses: list[float] = []
    policy = clone(ENVIRONMENT, read, 1, lambda steps, loss: losses.append(loss))
    assert losses[-1] < 0.1 * losses[0]
    again = clone(ENVIRONMENT, read, 1)
    policy.save(tmp_path / "one.safetensors")
    again.save(tmp_path / "two.safetensors")
    assert (tmp_path / "one.safetensors").read_bytes() == (tmp_path / "two.safetensors").read_bytes()
    unseen = episode(40, 99)
    actor = Actor(policy, 1)
    acted = np.array([actor.compute_mean_actions(row[None])[0] for row in unseen.observations])
    assert np.corrcoef(acted[:, 0], unseen.actions[:, 0])[0, 1] > 0.8


@pytest.mark.parametrize(
    ("environment", "words"),
    [
        (
            "avrgym/ScratchItchJaco-v1",
            "contains .*mouth.*needs .*itch.*Export demonstrations of this environment",
        ),
        ("avrgym/FeedingPR2-v1", "with the robot Jaco at 10 Hz; avrgym/FeedingPR2-v1 needs PR2 at 10 Hz"),
    ],
)
def test_datasets_of_other_environments_are_refused(tmp_path: Path, environment: str, words: str) -> None:
    folder = dataset(tmp_path / "d", [episode(3, 0)])
    out = tmp_path / "clone.safetensors"
    run = CliRunner().invoke(app, ["clone", environment, str(folder), "--out", str(out)])
    assert run.exit_code == 1
    with pytest.raises(ValueError, match=words):
        read_episodes(environment, [folder])
    with pytest.raises(ValueError, match=r"not a LeRobot dataset .*allowed: a folder of `avrgym export`"):
        read_episodes(environment, [tmp_path])
    assert not out.exists()
