"""``avrgym train --recipe``: the settings are the recipe's, and whoever says otherwise is told."""

from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

pytest.importorskip("stable_baselines3", reason="training is an extra")

from avrgym.cli.main import app
from avrgym.learning import adaptive
from avrgym.learning.configuration import PAPER_STEPS, stored_configuration
from avrgym.policies.trained import Policy
from helpers.learning.small_training import train_little
from helpers.vr.visit import ENVIRONMENT


def train(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["train", ENVIRONMENT, *map(str, arguments)])


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--recipe", "secret"], "allowed: adaptive, paper"),
        (["--recipe", "paper", "--config", "settings.toml"], "leave out --config"),
        (["--recipe", "adaptive", "--people", "revised", "--impairment", "tremor"], "--people, --impairment"),
        (["--recipe", "paper", "--teacher", "revised"], "--teacher goes with a new training"),
        (["--recipe", "pair", "--initial-policy", "adaptive"], "--initial-policy goes with a new training"),
        (["--recipe", "adaptive", "--resume", "--initial-policy", "adaptive"], "goes with a new training"),
        (["--recipe", "adaptive", "--initial-policy", "revised", "--worlds", "1"], "a policy that remembers"),
        (["--recipe", "adaptive", "--teacher", "nobody", "--worlds", "1"], "no policy 'nobody'"),
        (["--recipe", "paper", "--imitation-share", "1"], "--imitation-share goes with a new training"),
        (
            ["--recipe", "adaptive", "--initial-policy", "adaptive", "--teacher", "revised", "--worlds", "1"],
            "leave out the teacher, or give the share",
        ),
    ],
)
def test_what_a_recipe_leaves_no_choice_of_is_refused(arguments: list[str], told: str) -> None:
    result = train(*arguments)
    assert result.exit_code == 1
    (line,) = result.stderr.splitlines()
    assert told in line


@pytest.mark.slow
def test_the_papers_recipe_is_ppo_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    train_little(monkeypatch)
    for steps, more in ((400, []), (800, ["--resume"])):
        result = train("--people", "revised", "--recipe", "paper", "--steps", str(steps), *more)
        assert result.exit_code == 0, result.stderr
        out = tmp_path / "runs" / "FeedingJaco-v1-revised-paper-0"
        assert Policy.load(out / "policy.safetensors").metadata.steps == steps
        made = stored_configuration(out)
        assert made.imitation_steps == 0
        assert made.hidden == (64, 64)
        assert made.force_weight_at(steps) == made.detour_weight_per_m == made.hard_share == 0.0
        assert made.actor_learns_at(0)


def test_the_papers_recipe_takes_ten_million_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    class AskedError(Exception):
        pass

    def asked(environment: str, people: str, steps: int, *rest: object) -> None:
        assert (environment, people, steps) == (ENVIRONMENT, "original", PAPER_STEPS)
        raise AskedError

    from avrgym.learning import training

    monkeypatch.setattr(training, "configuration_for", asked)
    assert isinstance(train("--recipe", "paper").exception, AskedError)


@pytest.mark.slow
def test_the_adaptive_recipe_leaves_a_policy_that_remembers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, value in {"MEASURED_EPISODES": 1, "PASSES": 1, "LAST_PASSES": 1}.items():
        monkeypatch.setattr(adaptive, name, value)
    result = train("--recipe", "adaptive", "--steps", "200", "--worlds", "1")
    assert result.exit_code == 0, result.stderr
    out = tmp_path / "runs" / "FeedingJaco-v1-adaptive-0"
    assert Policy.load(out / "policy.safetensors").memory is not None
    again = train("--recipe", "adaptive", "--resume", "--out", out)
    assert again.exit_code == 1
    assert "complete" in again.stderr


@pytest.mark.parametrize("more", [[], ["--initial-policy", "adaptive"]])
def test_a_share_of_the_adaptive_recipe_s_rounds_imitates(
    more: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    class AskedError(Exception):
        pass

    def asked(training: adaptive.AdaptiveTraining, *rest: object) -> None:
        assert training.imitation_rounds == training.rounds == 3
        raise AskedError

    monkeypatch.setattr(adaptive, "train", asked)
    given = ("--recipe", "adaptive", "--imitation-share", "1", "--steps", "1200", "--worlds", "2")
    assert isinstance(train(*given, *more).exception, AskedError)
