"""``avrgym train --recipe``: hyperparameters and rejected options."""

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.cli.main import app
from avrgym.learning import recurrent_recipe, training
from avrgym.learning.configuration import (
    AnyTrainingConfiguration,
    FeedforwardConfiguration,
    RecurrentConfiguration,
    read_configuration,
)
from avrgym.learning.hyperparameters import PAPER_TRAINING_STEPS, RECURRENT_HYPERPARAMETERS
from avrgym.policies.trained_policies import Policy
from helpers.learning.small_training import shorten_training
from helpers.vr.visit import ENVIRONMENT


def train(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["train", ENVIRONMENT, *map(str, arguments)])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--recipe", "secret"], "allowed: adaptive, paper"),
        (["--recipe", "paper", "--config", "settings.toml"], "--recipe paper does not accept --config"),
        (
            ["--recipe", "adaptive", "--people", "revised", "--impairment", "tremor"],
            "does not accept --people, --impairment",
        ),
        (["--recipe", "paper", "--teacher", "revised"], "--teacher needs --recipe adaptive"),
        (["--recipe", "pair", "--initial-policy", "adaptive"], "--initial-policy needs --recipe adaptive"),
        (
            ["--recipe", "adaptive", "--resume", "--initial-policy", "adaptive"],
            "--resume does not accept --initial-policy",
        ),
        (["--recipe", "adaptive", "--initial-policy", "revised", "--num-envs", "1"], "a recurrent policy"),
        (["--recipe", "adaptive", "--teacher", "nobody", "--num-envs", "1"], "no policy 'nobody'"),
        (["--recipe", "paper", "--imitation-share", "1"], "--imitation-share needs --recipe adaptive"),
        (
            [
                "--recipe",
                "adaptive",
                "--initial-policy",
                "adaptive",
                "--teacher",
                "revised",
                "--num-envs",
                "1",
            ],
            "remove the teacher, or set the imitation share above 0",
        ),
    ],
)
def test_recipes_reject_options_of_other_recipes(arguments: list[str], message: str) -> None:
    result = train(*arguments)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert message in line


@pytest.mark.slow
def test_the_papers_recipe_uses_only_ppo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shorten_training(monkeypatch)
    for steps, more in ((400, []), (800, ["--resume"])):
        result = train("--people", "revised", "--recipe", "paper", "--steps", str(steps), *more)
        assert result.exit_code == 0, result.stderr
        out = tmp_path / "runs" / "FeedingJaco-v1-revised-paper-0"
        assert Policy.load(out / "policy.safetensors").metadata.steps == steps
        made = read_configuration(out)
        assert isinstance(made, FeedforwardConfiguration)
        assert made.imitation_steps == 0
        assert made.net_arch == (64, 64)
        assert made.compute_force_weight(steps) == made.detour_weight_per_m == made.hard_share == 0.0
        assert made.is_actor_learning(0)


class TrainCalled(Exception):
    """Raised instead of a training."""


def given_configuration(patch: pytest.MonkeyPatch, *arguments: str) -> AnyTrainingConfiguration:
    """Return the configuration that a command would train."""
    given: list[AnyTrainingConfiguration] = []

    def train_nothing(configuration: AnyTrainingConfiguration, *rest: object, **named: object) -> None:
        given.append(configuration)
        raise TrainCalled

    patch.setattr(training, "train", train_nothing)
    assert isinstance(train(*arguments).exception, TrainCalled)
    return given[0]


def test_the_papers_recipe_trains_ten_million_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    assert given_configuration(monkeypatch, "--recipe", "paper").steps == PAPER_TRAINING_STEPS


@pytest.mark.slow
def test_the_adaptive_recipe_trains_a_recurrent_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    monkeypatch.setattr(
        recurrent_recipe,
        "RECURRENT_HYPERPARAMETERS",
        replace(RECURRENT_HYPERPARAMETERS, final_round_gradient_steps=1),
    )
    result = train("--recipe", "adaptive", "--steps", "200", "--num-envs", "1")
    assert result.exit_code == 0, result.stderr
    out = tmp_path / "runs" / "FeedingJaco-v1-adaptive-0"
    assert Policy.load(out / "policy.safetensors").memory is not None
    again = train("--recipe", "adaptive", "--resume", "--out", out)
    assert again.exit_code == 1
    assert "complete" in again.stderr


@pytest.mark.parametrize("more", [[], ["--initial-policy", "adaptive"]])
def test_imitation_share_sets_the_number_of_updates(more: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    options = ("--recipe", "adaptive", "--imitation-share", "1", "--steps", "1200", "--num-envs", "2")
    configuration = given_configuration(monkeypatch, *options, *more)
    assert isinstance(configuration, RecurrentConfiguration)
    assert configuration.imitation_updates == configuration.total_updates == 3
