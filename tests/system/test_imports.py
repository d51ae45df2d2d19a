"""`import avrgym` and `avrgym --help` import no heavy package."""

import json
import subprocess
import sys

import pytest

import avrgym
from avrgym.people import population_names
from avrgym.people.distributions import POPULATION_DISTRIBUTIONS
from avrgym.robots.registry import ROBOTS
from avrgym.tasks import constants
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from helpers.system.requirements import modules_of_extras

LIBRARIES = {
    "PIL", "alembic", "av", "cryptography", "fastapi", "h5py", "matplotlib", "mcap", "msgspec", "mujoco",
    "onnxruntime", "pandas", "playwright", "pyarrow", "pydantic", "rich", "rtb_data", "safetensors", "scipy", "segno",
    "sqlalchemy", "stable_baselines3", "tensorboard", "tomlkit", "torch", "trimesh", "uvicorn", "websockets",
}  # fmt: skip
OURS = {
    "avrgym.analysis", "avrgym.demo", "avrgym.doctor", "avrgym.learning", "avrgym.models.human",
    "avrgym.people.people_file",
    "avrgym.policies.registry", "avrgym.questionnaires", "avrgym.recording", "avrgym.replay", "avrgym.robots",
    "avrgym.simulation", "avrgym.skeletons", "avrgym.study.storage.store", "avrgym.tasks.registry",
    "avrgym.vr.server.live_server",
}  # fmt: skip
SERVING = {
    "alembic", "cryptography", "fastapi", "matplotlib", "mcap", "segno", "sqlalchemy", "starlette", "uvicorn",
    "websockets", "avrgym.analysis", "avrgym.recording", "avrgym.study", "avrgym.vr",
}  # fmt: skip
"""What only sessions, studies and their results need."""
HELP = """
import sys
from avrgym.cli import app

sys.argv = ["avrgym", "--help"]
try:
    app()
except SystemExit:
    pass
"""


TRAINING = """
import sys, avrgym, avrgym.learning.training
from avrgym.learning.evaluation import evaluate

evaluate("avrgym/FeedingJaco-v1", "revised", "revised", 1, 0)
"""


def imported(program: str) -> set[str]:
    """The modules that a program has imported when it ends."""
    ran = subprocess.run(
        [sys.executable, "-c", f"{program}\nprint('modules', *sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return set(ran.stdout.split("modules", 1)[1].split())


@pytest.mark.parametrize("program", ["import sys, avrgym", HELP], ids=["import avrgym", "avrgym --help"])
def test_large_packages_are_not_imported(program: str) -> None:
    modules = imported(program)
    assert {"avrgym.tasks.constants", "gymnasium"} <= modules
    assert sorted(modules & (LIBRARIES | OURS)) == []


@pytest.mark.slow
def test_training_imports_no_server_packages() -> None:
    modules = imported(TRAINING)
    assert {"torch", "mujoco", "avrgym.tasks.episodes"} <= modules
    assert sorted(modules & SERVING) == []


def test_constants_equal_those_of_the_tasks() -> None:
    ours = {task: TASKS[task].name for task in constants.PACKAGED_TASKS} | {
        robot: ROBOTS[robot].name for robot in constants.PACKAGED_ROBOTS
    }
    assert all(name == of_record for name, of_record in ours.items())
    packaged = [
        each
        for each, (task, robot) in ENVIRONMENTS.items()
        if task in constants.PACKAGED_TASKS and robot in constants.PACKAGED_ROBOTS
    ]
    assert packaged == [*constants.PACKAGED_ENVIRONMENTS]
    assert (*POPULATION_DISTRIBUTIONS,) == population_names.POPULATION_NAMES


def test_people_are_at_hand_without_an_import_of_their_own() -> None:
    program = "import sys, avrgym; avrgym.models.human.Person('man', 0.62)"
    assert "avrgym.models.human" in imported(program)
    with pytest.raises(AttributeError, match="no attribute 'modles'"):
        avrgym.modles  # noqa: B018


CORE = """
import json
import sys


class WithoutExtras:
    missing = set(json.loads(sys.argv[1]))

    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in self.missing:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)


sys.meta_path.insert(0, WithoutExtras())
import gymnasium as gym

import avrgym
from avrgym.cli import app

with gym.make("avrgym/FeedingJaco-v1", render_mode="rgb_array") as env:
    env.reset(seed=0)
    env.step(env.action_space.sample())
    env.render()
gym.make_vec("avrgym/ScratchItchPR2-v1", num_envs=1, people="zoo/unseen").reset(seed=0)
app(["evaluate", "avrgym/FeedingJaco-v1", "--policy", "adaptive", "--episodes", "1"], standalone_mode=False)
app(["study", "new", "study"])
"""


@pytest.mark.slow
def test_environments_and_policies_need_no_extra(tmp_path):
    """``test_installed_wheel`` shows it in a virtual environment that has no package of an extra."""
    missing = json.dumps(sorted(modules_of_extras()))
    ran = subprocess.run([sys.executable, "-c", CORE, missing], cwd=tmp_path, capture_output=True, text=True)
    assert ran.returncode == 1
    assert ran.stderr == "avrgym: sqlalchemy is missing; run `pip install 'avrgym[study]'`\n"
    assert "adaptive" in ran.stdout
