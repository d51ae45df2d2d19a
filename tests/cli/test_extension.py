"""The environments of the example package work with every command of AVR Gym."""

import json
import re
from pathlib import Path

import httpx
import pytest

from avrgym.tasks.constants import PACKAGED_ROBOTS, PACKAGED_TASKS
from helpers.browser.glb import GlbFile
from helpers.system.example_package import avrgym, environment_variables, install, python, train_and_study
from helpers.system.paths import ROOT
from helpers.system.processes import running_server
from helpers.vr.time_limits import RELAXED_LIMITS

TASK, ROBOT = "Handover", "Jaco"
ENVIRONMENT = f"avrgym/{TASK}{ROBOT}-v1"
MAX_LINES = 150
TRAINING_STEPS = 2000
CHECK = f"""
import avrgym
import gymnasium as gym
from gymnasium.utils.env_checker import check_env
from avrgym.tasks.task_check import check_task

check_env(gym.make("{ENVIRONMENT}").unwrapped, skip_render_check=True)
check_task("{TASK}")
"""

LIFT = f"""
import json
from avrgym.learning.evaluation import evaluate_all

environments = [f"avrgym/{TASK}{{robot}}-v1" for robot in ("Jaco", "PR2", "UR5")]
rates = {{}}
for policy in ("oracle", "hold-still"):
    rows = evaluate_all(environments, policy, "revised", 10, 0, jobs=1)
    rates[policy] = [row.success_rate for row in rows]
print(json.dumps(rates))
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the example package and a broken one."""
    folder = tmp_path_factory.mktemp("site")
    install(folder)
    return folder


def test_files_are_short() -> None:
    package = ROOT / "examples" / "extension"
    files = [path for path in package.rglob("*") if path.suffix in (".py", ".xml", ".toml")]
    lines = {str(path.relative_to(package)): len(path.read_text().splitlines()) for path in files}
    print(lines)
    assert max(lines.values()) < MAX_LINES


@pytest.mark.slow
def test_environments_are_listed_and_broken_ones_are_skipped(installed: Path) -> None:
    said = " ".join(avrgym(installed, "envs", "--json", "envs.json").split())
    listed = {row["env"] for row in json.loads((installed / "envs.json").read_text())}
    for made in [f"{task}{robot}" for task in PACKAGED_TASKS for robot in ("Jaco", "PR2", "Fetch")]:
        assert f"avrgym/{made}-v1" in listed
    assert {env for env in listed if TASK in env} == {
        f"avrgym/{TASK}{r}-v1" for r in (*PACKAGED_ROBOTS, "Fetch")
    }
    broken = r"skipped unfinished = unfinished:MISSING \(unfinished 1.0\): ModuleNotFoundError"
    assert len(re.findall(broken, said)) >= 2, said


@pytest.mark.slow
def test_environment_checks_pass(installed: Path) -> None:
    python(installed, "-c", CHECK)


@pytest.mark.slow
def test_the_arm_can_be_lifted_but_not_by_the_example_controller(installed: Path) -> None:
    rates = json.loads(python(installed, "-c", LIFT).splitlines()[-1])
    assert min(rates["oracle"]) >= 0.5
    assert max(rates["hold-still"]) == 0.0


@pytest.mark.slow
def test_extension_supports_training_study_report_and_replay(installed: Path) -> None:
    train_and_study(
        installed, TASK, ROBOT, "within_reach", TRAINING_STEPS, policies=("hold-still",), little=True
    )


@pytest.mark.slow
def test_the_server_sends_the_scene(installed: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", environment_variables(installed)["PYTHONPATH"])
        with running_server(
            installed / "served", "--env", ENVIRONMENT, "--policy", "hold-still", limits=RELAXED_LIMITS
        ) as running:
            address, token = running.participant.split("/#token=")
            allowed = {"authorization": f"Bearer {token}"}
            scene = httpx.get(f"{address}/scenes/0.glb", headers=allowed, timeout=60.0)
    assert scene.status_code == 200
    bodies = GlbFile(scene.content).nodes("body")
    assert {"person/right_forearm", "robot/link_7", "wheelchair"} <= bodies.keys()
