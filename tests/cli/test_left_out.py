"""Commands for all environments skip and name the environments of broken extensions."""

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner, Result

import avrgym.envs.benchmark as simulation_benchmark
import avrgym.vr.benchmark.live_latency as vr_benchmark
from avrgym.cli.main import app
from avrgym.learning.cross_play import _environments_with
from avrgym.policies import registry as policies
from avrgym.tasks import registry
from avrgym.tasks.task import Expert
from helpers.system.example_package import environment_variables

BRIEF = "--episodes", "1", "--episode-steps", "2", "--jobs", "1"
OWN, EXTENSION = "avrgym/FeedingJaco-v1", "avrgym/StirJaco-v1"


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [*map(str, arguments)])


def fail(*_: Any) -> Any:
    raise KeyError("spoon")


@pytest.fixture
def extend(monkeypatch: pytest.MonkeyPatch) -> Callable[[Expert], None]:
    """Return a function that registers an environment of this package and one of an extension with an expert."""

    def extended(expert: Expert) -> None:
        feeding = registry.TASKS["Feeding"]
        monkeypatch.setitem(registry.TASKS, "Stir", replace(feeding, name="Stir", expert=expert))  # type: ignore[arg-type]
        monkeypatch.setattr(registry, "ENVIRONMENTS", {OWN: ("Feeding", "Jaco"), EXTENSION: ("Stir", "Jaco")})

    return extended


@pytest.mark.parametrize(
    ("policies", "expected"),
    [
        (["adaptive"], [(OWN, "adaptive")]),
        (["adaptive", "zero"], [(OWN, "adaptive"), (OWN, "zero"), (EXTENSION, "zero")]),
        (["oracle"], [(OWN, "oracle")]),
    ],
    ids=lambda value: value[0] if isinstance(value[0], str) else "",
)
def test_evaluate_skips_environments_that_fail(
    policies: list[str], expected: list[tuple[str, str]], extend: Callable[[Expert], None], tmp_path: Path
) -> None:
    extend(fail)
    options = [word for policy in policies for word in ("--policy", policy)]
    rows = tmp_path / "rows.json"
    done = avrgym("evaluate", "--all", *options, *BRIEF, "--json", rows)
    assert done.exit_code == 0, done.output
    assert [(row["env"], row["policy"]) for row in json.loads(rows.read_text())] == expected
    (named,) = done.stderr.splitlines()
    assert named.startswith(f"left out  {EXTENSION} with {policies[0]}")
    assert ("KeyError: 'spoon'" if policies == ["oracle"] else "no policy 'adaptive'") in named


def test_one_line_lists_the_environments_without_a_policy() -> None:
    lacking = ["avrgym/FeedingPanda-v1", "avrgym/FeedingUR5-v1"]
    lines: list[str] = []
    found = _environments_with(
        [OWN, *lacking],
        "adaptive",
        policies.resolve_policy,
        lambda what, error: lines.append(f"{what}: {error}"),
    )
    assert found == {OWN}
    (line,) = lines
    assert line.startswith(f"{', '.join(lacking)} with adaptive: no policy 'adaptive' for {lacking[0]}")


def test_rows_equal_those_of_single_evaluations(extend: Callable[[Expert], None], tmp_path: Path) -> None:
    extend(registry.TASKS["Feeding"].expert)
    options = ["--policy", "zero", "--policy", "oracle", *BRIEF, "--json"]
    together, alone = tmp_path / "all.json", tmp_path / "alone.json"
    assert avrgym("evaluate", "--all", *options, together).exit_code == 0
    assert avrgym("evaluate", OWN, EXTENSION, *options, alone).exit_code == 0
    assert json.loads(together.read_text()) == json.loads(alone.read_text())


def test_a_matrix_has_no_row_of_a_skipped_environment(extend: Callable[[Expert], None]) -> None:
    extend(fail)
    done = avrgym("evaluate", "--all", "--cross-play", "--policy", "zero", "--policy", "adaptive",
                  "--people", "original", "--people", "revised", *BRIEF)  # fmt: skip
    assert done.exit_code == 0, done.output
    assert [EXTENSION in line for line in done.stdout.splitlines() if "adaptive" in line] == [False]


def test_an_unknown_name_is_an_error(extend: Callable[[Expert], None]) -> None:
    extend(fail)
    for option, name in (("--policy", "adaptvie"), ("--people", "orignal")):
        refused = avrgym("evaluate", "--all", option, name)
        assert refused.exit_code == 1
        (line,) = refused.stderr.splitlines()
        assert name in line
        assert "left out" not in line


def test_a_named_environment_that_fails_is_an_error(extend: Callable[[Expert], None]) -> None:
    extend(fail)
    refused = avrgym("evaluate", OWN, EXTENSION, "--policy", "adaptive", *BRIEF)
    assert refused.exit_code == 1
    assert refused.stderr.startswith(f"avrgym: no policy 'adaptive' for {EXTENSION}")


def test_no_environment_left_is_an_error(
    extend: Callable[[Expert], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    extend(fail)
    monkeypatch.setattr(registry, "ENVIRONMENTS", {EXTENSION: ("Stir", "Jaco")})
    refused = avrgym("evaluate", "--all", "--policy", "oracle", *BRIEF)
    assert refused.exit_code == 1
    assert (
        refused.stderr.splitlines()[-1]
        == "avrgym: no environment was evaluated: all were skipped; correct the errors above"
    )


@pytest.mark.parametrize("what", ["sim", "vr"])
def test_bench_skips_environments_that_fail(
    what: str, extend: Callable[[Expert], None], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    extend(fail)
    module, name = {
        "sim": (simulation_benchmark, "measure_simulation_speed"),
        "vr": (vr_benchmark, "measure_live_latency"),
    }[what]
    monkeypatch.setattr(
        f"avrgym.cli.bench._{'stages' if what == 'vr' else 'brief'}", lambda _: [{"stage": 1}]
    )
    monkeypatch.setattr("avrgym.cli.bench.asdict", lambda row: row)
    monkeypatch.setattr("avrgym.cli.bench._brief", lambda row: row)
    monkeypatch.setattr(module, name, lambda env, *_: {"env": env} if env == OWN else fail())
    done = avrgym("bench", what, "--json", tmp_path / "rows.json")
    assert done.exit_code == 0, done.output
    assert json.loads((tmp_path / "rows.json").read_text()) == [{"env": OWN}]
    assert f"left out  {EXTENSION}: KeyError: 'spoon'" in done.stderr
    assert not isinstance(avrgym("bench", what, "--env", EXTENSION).exception, SystemExit)


@pytest.mark.slow
def test_a_plug_in_that_raises_system_exit_is_skipped(tmp_path: Path) -> None:
    about = tmp_path / "leaver-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: leaver\nVersion: 1.0\n")
    groups = ("tasks", "robots", "controllers")
    (about / "entry_points.txt").write_text(
        "".join(f"[avrgym.{each}]\nleaver = leaver:IT\n" for each in groups)
    )
    (tmp_path / "leaver.py").write_text("raise SystemExit('no licence')\n")
    ran = subprocess.run(
        [sys.executable, "-c", "from avrgym.cli import app; app()", "envs"],
        env=environment_variables(tmp_path), cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr
    assert OWN in ran.stdout
    assert "SystemExit: no licence" in " ".join(ran.stdout.split())
