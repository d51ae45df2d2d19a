"""`avrgym doctor`: output and JSON of all checks, and the exit code."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.doctor.checks import COMPUTER_CHECKS, run_checks
from avrgym.doctor.finding import Check, make_ok_finding
from avrgym.system.mujoco_setup import DISPLAY_VARIABLES, RENDERING_HINT


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_working_computer_has_no_errors_and_no_leftover_files(tmp_path: Path) -> None:
    told = CliRunner().invoke(app, ["doctor", "--json", "found.json"])
    assert told.exit_code == 0, told.output
    rows = json.loads(Path("found.json").read_text())
    assert [row["check"] for row in rows] == [check.name for check in COMPUTER_CHECKS]
    assert [row["check"] for row in rows if bool(row["fix"]) is (row["state"] == "ok")] == []
    for row in rows:
        assert row["message"] in told.stdout
        assert row["fix"] in told.stdout
    assert "an image was rendered by " in told.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["found.json"]


def test_an_error_sets_exit_code_1_and_prints_the_fix(monkeypatch: pytest.MonkeyPatch) -> None:
    for screen in DISPLAY_VARIABLES:
        monkeypatch.delenv(screen, raising=False)
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    told = CliRunner().invoke(app, ["doctor"])
    assert told.exit_code == 1
    assert re.search(r"error +OpenGL +no image can be rendered with MUJOCO_GL=glfw: \w+", told.stdout)
    assert RENDERING_HINT in told.stdout
    assert "errors: 1" in told.stdout


def test_an_exception_in_a_check_is_an_error_result() -> None:
    def fail():
        raise OSError("broken installation")

    found = dict(run_checks((Check("broken", fail), Check("sound", lambda: make_ok_finding("well")))))
    assert (found["broken"].state, found["sound"].state) == ("error", "ok")
    assert "broken installation" in found["broken"].message
