"""A sweep runs every training of its file as ``train`` does, and resumes."""

import json
import os
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.cli.main import app
from avrgym.learning.configuration import make_feedforward_configuration
from avrgym.learning.sweep_file import plan_training_runs, read_sweep
from helpers.system.paths import ROOT

LITTLE = """
environments = ["avrgym/ScratchItchJaco-v1"]
steps = 1200
seeds = [0, 1]

[recipes.little]
num_envs = 1
batch_size = 100
n_epochs = 1
imitation_rounds = 1
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "sweep.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_sweep_has_every_combination_once(tmp_path: Path) -> None:
    sweep = read_sweep(written(tmp_path, LITTLE + "\n[recipes.usual]\n"))
    (group,) = plan_training_runs(sweep, "sweep.toml").values()
    assert [(each.recipe_name, each.configuration.seed) for each in group] == [
        ("little", 0),
        ("little", 1),
        ("usual", 0),
        ("usual", 1),
    ]
    assert len({each.folder_name for each in group}) == 4
    usual = make_feedforward_configuration("avrgym/ScratchItchJaco-v1", "original", 1200, 1)
    assert group[3].configuration == usual
    changed = {"num_envs": 1, "batch_size": 100, "n_epochs": 1, "imitation_rounds": 1}
    assert group[1].configuration == replace(usual, **changed)


def test_the_example_is_a_sweep() -> None:
    path = ROOT / "examples" / "clusters" / "sweep.toml"
    assert sum(map(len, plan_training_runs(read_sweep(path), str(path)).values())) == 12


@pytest.mark.parametrize(
    ("change", "message"),
    [
        pytest.param(("steps = 1200", "steps = 0"), "steps: expected `int` >= 1", id="steps"),
        pytest.param(("seeds", "seedz"), "unknown key seedz; allowed: environments, steps, seeds", id="key"),
        pytest.param(("ScratchItchJaco", "Cooking"), "allowed: avrgym/FeedingJaco", id="environment"),
        pytest.param(("n_epochs", "n_epoch"), "recipes.little: unknown hyperparameter n_epoch", id="setting"),
        pytest.param(("batch_size = 100", "batch_size = 1"), "batch_size: expected `int` >= 2", id="value"),
        pytest.param(("[recipes", "[[recipes"), "invalid TOML", id="toml"),
        pytest.param(("recipes.little", 'recipes."../out"'), "matching regex", id="name"),
    ],
)
def test_an_invalid_sweep_is_refused_in_one_line(
    tmp_path: Path, change: tuple[str, str], message: str
) -> None:
    pytest.importorskip("ray", reason="clusters are an extra, too large for every computer")
    out = tmp_path / "out"
    file = written(tmp_path, LITTLE.replace(*change))
    result = CliRunner().invoke(app, ["sweep", str(file), "--out", str(out)])
    assert result.exit_code == 1
    assert message in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.filterwarnings("ignore")  # of Ray's, whose processes and files end with its shutdown
def test_a_sweep_equals_single_trainings_and_resumes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray.tune", reason="clusters are an extra, too large for every computer")
    from avrgym.learning import sweep, training
    from avrgym.policies.trained_policies import Policy
    from avrgym.system.cluster import connect_to_cluster
    from helpers.learning.ray_nodes import assert_same_training

    out, reported = tmp_path / "out", dict[str, int]()
    sweep.create_sweep(written(tmp_path, LITTLE), out)
    with pytest.raises(FileExistsError, match="already contains a sweep"):
        sweep.create_sweep(tmp_path / "sweep.toml", out)
    first, second = next(iter(sweep.read_planned_runs(out).values()))
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    training.train(replace(first.configuration, threads=1), tmp_path / "alone")
    training.train(replace(first.configuration, threads=1), out / first.folder_name)
    measured = (out / first.folder_name / "policy.safetensors").stat().st_mtime_ns
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT / "src")]))
    with connect_to_cluster("local") as _:
        rows = sweep.run_sweep(out, None, reported.__setitem__)
    assert [(row.seed, row.outcome, row.steps) for row in rows] == [
        (0, "complete", 1200),
        (1, "complete", 1200),
    ]
    assert reported == {first.folder_name: 1200, second.folder_name: 1200}
    assert (out / first.folder_name / "policy.safetensors").stat().st_mtime_ns == measured
    assert Policy.load(rows[1].policy).metadata.measured["success_rate"] == rows[1].success_rate
    training.train(replace(second.configuration, threads=1), tmp_path / "second")
    assert_same_training(out / second.folder_name, tmp_path / "second")
    assert json.loads(json.dumps(asdict(rows[0])))["env"] == "avrgym/ScratchItchJaco-v1"
