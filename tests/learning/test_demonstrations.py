"""Demonstrations of simulated operators, and their datasets in LeRobot's format."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.learning import demonstrations
from avrgym.learning.demonstrations import simulate_demonstrations
from avrgym.learning.lerobot_dataset import DatasetEpisode, FeatureStatistics, write_dataset
from avrgym.people.motor_model import SPEED_NOISE_FRACTION
from avrgym.policies.registry import resolve_policy
from avrgym.policies.simulated_operator import COMMAND_DELAY_S, SimulatedOperator
from avrgym.system.random_streams import make_demonstration_rng
from avrgym.tasks.episodes import Episodes
from helpers.learning.lerobot_policies import lerobot_python, run_lerobot

FEEDING = "avrgym/FeedingJaco-v1"


def test_operators_act_late_and_their_noise_grows_with_the_speed() -> None:
    generators = [make_demonstration_rng(0, attempt) for attempt in range(200)]
    operator = SimulatedOperator(generators, 2, 10)
    actions = np.stack([operator.compute_commands(np.tile([0.5, 0.1], (200, 1))) for _ in range(40)])
    delay = round(10 * COMMAND_DELAY_S)
    assert not actions[:delay].any()
    assert actions[delay:].mean(axis=(0, 1)) == pytest.approx([0.5, 0.1], rel=0.02)
    assert actions[delay:].std(axis=(0, 1)) == pytest.approx(
        [0.5 * SPEED_NOISE_FRACTION, 0.1 * SPEED_NOISE_FRACTION], rel=0.05
    )


def successes(worlds: int, seed: int, *, episodes: int = 3) -> list[DatasetEpisode]:
    world = Episodes(FEEDING, worlds, people="revised")
    return [*simulate_demonstrations(world, resolve_policy("oracle", FEEDING), episodes, 120, seed)]


@pytest.mark.slow
def test_the_number_of_worlds_does_not_change_episodes() -> None:
    one, three = successes(1, 5), successes(3, 5)
    for alone, together in zip(one, three, strict=True):
        assert alone.episode_columns == together.episode_columns
        assert alone.successes[-1]
        assert_array_equal(alone.observations, together.observations)
        assert_array_equal(alone.actions, together.actions)


def test_a_policy_without_success_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demonstrations, "MAX_ATTEMPTS_PER_SUCCESS", 2)
    world = Episodes(FEEDING, 2)
    with pytest.raises(ValueError, match="0 of 2 attempts succeeded; use a policy with more success"):
        next(simulate_demonstrations(world, resolve_policy("zero", FEEDING), 1, 2, 0))


def test_statistics_of_images_are_those_of_all_pixels() -> None:
    random = np.random.default_rng(0)
    parts = [random.integers(0, 256, (count, 5, 4, 3), np.uint8) for count in (1, 3)]
    found = (FeatureStatistics(parts[0]) + FeatureStatistics(parts[1])).to_dict()
    colours = np.concatenate(parts).reshape(-1, 3) / 255.0
    expected = {
        "min": colours.min(axis=0),
        "max": colours.max(axis=0),
        "mean": colours.mean(axis=0),
        "std": colours.std(axis=0),
        **{f"q{share:02}": np.quantile(colours, share / 100, axis=0) for share in (1, 10, 50, 90, 99)},
    }
    for name, values in expected.items():
        np.testing.assert_allclose(np.ravel(found[name]), values, rtol=1e-9, err_msg=name)
        assert np.shape(found[name]) == (3, 1, 1)
    assert found["count"] == [4]


def test_in_a_dataset_with_images_policies_see_the_person_only_there(tmp_path: Path) -> None:
    world = Episodes(FEEDING, 1)
    steps = 2
    episode = DatasetEpisode(
        "Help.",
        np.zeros((steps, 25)),
        *(np.zeros((steps, 7)), np.zeros(steps), np.zeros(steps, bool), np.zeros(steps)),
        images={"wrist_rgb": np.zeros((steps, 64, 64, 3), np.uint8)},
    )
    about: dict[str, Any] = {"observation": world.observation_spec, "scene": world.scene, "control_hz": 10}
    write_dataset(tmp_path / "data", [episode], **about)
    features = json.loads((tmp_path / "data" / "meta" / "info.json").read_text())["features"]
    seen = {name for name in features if name.startswith("observation")}
    assert seen == {"observation.state", "observation.images.wrist_rgb"}
    assert "head_rotation_w" in features["environment_state"]["names"]


LOAD = """
import json, sys
from lerobot.datasets.lerobot_dataset import LeRobotDataset
data = LeRobotDataset("avrgym/test", root=sys.argv[1])
frame = data[len(data) - 1]
print(json.dumps({
    "episodes": data.num_episodes, "fps": data.fps, "task": frame["task"],
    "success": bool(frame["next.success"]), "image": list(frame["observation.images.wrist_rgb"].shape),
    "state": frame["observation.state"].tolist(), "action": frame["action"].tolist(),
}))
"""


@pytest.mark.slow
def test_lerobot_opens_exported_demonstrations(tmp_path: Path) -> None:
    python = lerobot_python()
    if python is None:
        pytest.skip("LeRobot is not installed; AVRGYM_LEROBOT_PYTHON may name an environment that has it")
    out = tmp_path / "data"
    command = [
        "export",
        "simulated-demonstrations",
        FEEDING,
        str(out),
        "--episodes",
        "2",
        "--camera",
        "wrist:80x64",
    ]
    run = CliRunner().invoke(app, [*command, "--episode-steps", "120"])
    assert run.exit_code == 0, run.output
    assert "successes 2 of 2 attempts" in run.output
    found = json.loads(run_lerobot(python, LOAD, [str(out)]))
    frames: Any = pd.read_parquet(out / "data" / "chunk-000" / "file-000.parquet")
    assert found == {
        "episodes": 2,
        "fps": 10,
        "task": "Help the person: eat the food from the spoon.",
        "success": True,
        "image": [3, 64, 80],
        "state": frames["observation.state"].iloc[-1].tolist(),
        "action": frames["action"].iloc[-1].tolist(),
    }
