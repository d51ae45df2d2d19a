"""A task of another package, described in docs/how_to/add_a_task.md, can be used like a packaged task."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from avrgym.robots.registry import ROBOTS
from avrgym.skeletons.package_files import write_plugin_package
from avrgym.tasks.constants import PACKAGED_TASKS
from helpers.system.example_package import environment_variables, train_and_study
from helpers.system.paths import ROOT

PAGE = (ROOT / "docs" / "how_to" / "add_a_task.md").read_text()
_RECORD, _PARTICLES, CHECK = re.findall(r"^```python[^\n]*\n(.*?)^```", PAGE, re.M | re.S)
ENVIRONMENT = "avrgym/TouchElbowJaco-v1"


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> Path:
    """A folder of packages: that of the page, and one with tasks that are broken."""
    folder = tmp_path_factory.mktemp("site")
    write_plugin_package("task", "TouchElbow", folder / "new")
    (folder / "new" / "src" / "touch_elbow").rename(folder / "touch_elbow")
    (folder / "unfinished.py").write_text(
        "from dataclasses import replace\n"
        "from touch_elbow.task import TASK\n"
        "TWICE = TASK\n"
        "def scene(robot):\n    raise RuntimeError('no scene yet')\n"
        "NO_SCENE = replace(TASK, name='NoScene', make_scene=scene)\n"
    )
    entries = re.search(r'^\[project\.entry-points."avrgym\.tasks"\]\n(.*?)^```', PAGE, re.M | re.S)
    assert entries
    _install(folder, "touch-elbow", entries[1].replace('"', ""))
    _install(
        folder,
        "unfinished",
        "Missing = nowhere:TASK\nNoRecord = json:dumps\nNoScene = unfinished:NO_SCENE\nTwice = unfinished:TWICE\n",
    )
    return folder


def _install(folder: Path, name: str, entries: str) -> None:
    about = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[avrgym.tasks]\n{entries}")


def _python(installed: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *arguments],
        env=environment_variables(installed),
        cwd=installed,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def _avrgym(installed: Path, *arguments: str) -> "subprocess.CompletedProcess[str]":
    return _python(installed, "-c", "from avrgym.cli import app; app()", *arguments)


@pytest.mark.slow
def test_the_page_s_own_test_passes(installed):
    ran = _python(installed, "-c", CHECK)
    assert ran.returncode == 0, ran.stderr


def test_broken_tasks_are_named_and_skipped(installed):
    listed = _avrgym(installed, "envs", "--json", "envs.json")
    assert listed.returncode == 0, listed.stderr
    rows = json.loads((installed / "envs.json").read_text())
    assert [row["env"] for row in rows if row["task"] not in PACKAGED_TASKS] == [
        f"avrgym/TouchElbow{robot}-v1" for robot in ROBOTS
    ]
    said = " ".join(listed.stdout.split())
    for name, reason in (
        ("Missing = nowhere:TASK (unfinished 1.0)", "No module named 'nowhere'"),
        ("NoRecord = json:dumps (unfinished 1.0)", "allowed: Task"),
        ("avrgym/NoSceneJaco-v1", "no scene yet"),
        (
            "NoScene = unfinished:NO_SCENE (unfinished 1.0)",
            "task NoScene: no robot has the required arm, mount and grip",
        ),
        (
            "Twice = unfinished:TWICE (unfinished 1.0)",
            "a task with the name TouchElbow is already registered",
        ),
    ):
        assert re.search(f"skipped {re.escape(name)}: \\w+: .*{re.escape(reason)}", said), said


@pytest.mark.slow
def test_a_module_imported_before_avrgym_gets_a_clear_error(installed):
    ran = _python(installed, "-c", "import touch_elbow.task")
    assert ran.returncode == 0
    assert "touch_elbow.task was imported before avrgym; import avrgym first" in ran.stderr


@pytest.mark.slow
def test_it_is_evaluated_and_measured(installed):
    evaluated = _avrgym(
        installed, "evaluate", ENVIRONMENT, "--policy", "oracle", "--episodes", "4", "--json", "rows.json"
    )
    assert evaluated.returncode == 0, evaluated.stderr
    (row,) = json.loads((installed / "rows.json").read_text())
    assert row["success_rate"] >= 0.75
    measured = _avrgym(installed, "bench", "sim", "--env", ENVIRONMENT, "--num-envs", "2")
    assert measured.returncode == 0, measured.stderr


LIVE = f"""
import avrgym
from avrgym.models.human import Person
from avrgym.vr.live_world.world import LiveWorld

LiveWorld("{ENVIRONMENT}", Person()).reset(seed=1)
"""


@pytest.mark.slow
def test_a_participant_can_meet_it(installed):
    ran = _python(installed, "-c", LIVE)
    assert ran.returncode == 0, ran.stderr


@pytest.mark.slow
def test_it_is_trained_studied_reported_and_verified(installed):
    train_and_study(installed, "TouchElbow", "Jaco", "touched", 800, policies=(), little=True)
