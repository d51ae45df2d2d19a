"""Every command of the wheel, as pip installs it: with all that pip compiles, and nothing of this clone.

``tests/soak/soak_install.py`` installs its dependencies too; here they are those that the tests run with.
"""

import json
import re
import subprocess
import sys
import sysconfig
import venv
from collections.abc import Iterator, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from avrgym.cli.main import app
from helpers.system.paths import OLD_RECORDING, ROOT
from helpers.system.requirements import required
from helpers.vr.time_limits import RELAXED_LIMITS, command_with_limits

pytestmark = pytest.mark.slow

RUN = """
import json
import sys

import avrgym
from avrgym.cli import app

assert avrgym.__file__.startswith(sys.prefix), avrgym.__file__
for command in json.loads(sys.argv[1]):
    print("$ avrgym", *command, flush=True)
    assert not app(command, standalone_mode=False), command
"""
FEEDING = "avrgym/FeedingJaco-v1"
DESIGN = {
    "tasks": '["Feeding"]', "robots": '["Jaco"]', "policies": '["revised", "oracle"]', "practice_policy": '""',
    "trial_steps": "20", "free_movement_s": "0.0",
}  # fmt: skip
NEW = [["new", "task", "LiftArm"], ["new", "robot", "LongArm"], ["new", "controller", "LetGo"]]
PLUGINS = ("lift-arm", "long-arm", "let-go")
WITH_PLUGINS = [
    ["envs", "--json", "envs.json"],
    ["evaluate", "avrgym/LiftArmJaco-v1", "--policy", "oracle", "--episodes", "1"],
    ["evaluate", "avrgym/FeedingLongArm-v1", "--policy", "let-go", "--episodes", "1"],
]
ALONE = [
    ["export", "policy", "revised", FEEDING, "mine.onnx"],
    ["export", "scene", FEEDING, "scene"],
    ["bench", "sim", "--env", FEEDING, "--num-envs", "1"],
    ["bench", "vr", "--env", FEEDING, "--seconds", "1"],
    ["train", FEEDING, "--steps", "1", "--config", "little.toml", "--out", "run"],
    ["replay", str(OLD_RECORDING), "--verify"],
]
OF_A_STUDY = [
    ["study", "freeze", "study", "--template"],
    ["study", "enrol", "study", "--body", "man", "--age", "30", "--name", "Example Person"],
    ["study", "names", "study"],
    ["study", "encrypt-names", "study"],
    ["study", "add-experimenter", "study", "ada"],
    ["study", "experimenters", "study"],
    ["study", "revoke-experimenter", "study", "ada"],
    ["study", "participant-data", "study", "sub-001", "--out", "sub-001.zip"],
    ["study", "data-protection", "study"],
    ["study", "retention", "study"],
    ["study", "adverse-events", "study"],
    ["study", "withdraw", "study", "sub-001"],
    ["study", "delete-participant", "study", "sub-001"],
    ["study", "simulate", "study", "--participants", "2", "--jobs", "1"],
    ["study", "status", "study"],
    ["study", "check", "study"],
    ["analyze", "study"],
    ["fit-people", "study", "--out", "people.toml"],
    ["study", "export", "study", "--out", "bids", "--format", "bids"],
    ["study", "merge", "study", "--out", "merged"],
    ["study", "power", "study", "--simulations", "2", "--participants", "4", "--jobs", "1"],
]
REBUILD = ["study", "rebuild", "study"]
ELSEWHERE = {
    ("bench", "cameras"),
    ("demo",),
    ("demonstrate",),
    ("sweep",),
    ("export", "demonstrations"),
    ("export", "simulated-demonstrations"),
    ("fit-reward",),
    ("host",),
    ("study", "consent"),
    ("study", "functioning"),
    ("study", "furniture"),
    ("study", "input"),
    ("study", "invitations"),
    ("study", "invite"),
    ("study", "preferences"),
    ("study", "quality"),
    ("study", "respondent"),
    ("study", "record-adverse-event"),
    ("study", "confirm-participation"),
}
"""Commands that other tests run: they take minutes, need a cluster or participants, or ask for input."""
SERVERS = (["serve", "--port", "0", "--env", FEEDING], ["view", FEEDING, "--port", "0"])


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the virtual environment ``env``, in which there is the wheel."""
    folder = tmp_path_factory.mktemp("lab")
    call = f"import hatchling.build; hatchling.build.build_wheel({str(folder)!r})"
    subprocess.run([sys.executable, "-c", call], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    venv.create(folder / "env", with_pip=False, symlinks=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "env")}))
    (site / "dependencies.pth").write_text(f"{sysconfig.get_path('purelib')}\n")
    (wheel,) = folder.glob("*.whl")
    install(folder, wheel)
    assert list(site.rglob("templates/**/*.pyc")), "pip compiles what it installs"
    return folder


def install(lab: Path, *what: Path) -> None:
    """Install as pip does, without the network."""
    offline = ("--quiet", "--no-index", "--no-deps", "--no-build-isolation", "--ignore-installed")
    pip = [sys.executable, "-m", "pip", "--python", python(lab), "install", *offline, *what]
    subprocess.run(pip, check=True, timeout=300)


def python(lab: Path) -> Path:
    return lab / "env" / "bin" / "python"


def run(lab: Path, *commands: list[str]) -> str:
    """What commands print that run one after another in one process; all must succeed."""
    return called(lab, python(lab), "-c", RUN, json.dumps(commands))


def called(lab: Path, *command: str | Path) -> str:
    ran = subprocess.run(command, cwd=lab, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert ran.returncode == 0, ran.stdout
    return ran.stdout


def leaves(command: Any, *above: str) -> Iterator[tuple[str, ...]]:
    """The words of each command of the program."""
    below: Mapping[str, Any] = getattr(command, "commands", {})
    if not below:
        yield above
    for name, each in below.items():
        yield from leaves(each, *above, name)


def test_every_command_is_run_here_or_elsewhere() -> None:
    known = [*NEW, *WITH_PLUGINS, *ALONE, *OF_A_STUDY, REBUILD, *SERVERS, ["study", "new"], ["doctor"]]
    every = set(leaves(get_command(app)))
    ran = {next(words for words in every if tuple(line[: len(words)]) == words) for line in known}
    assert ran | ELSEWHERE == every


def test_every_command_has_help(lab: Path) -> None:
    said = run(lab, *([*words, "--help"] for words in leaves(get_command(app))))
    assert said.count("Usage: ") == len(list(leaves(get_command(app))))
    assert "Usage: avrgym" in called(lab, lab / "env" / "bin" / "avrgym", "--help")
    assert "errors: 0" in called(lab, lab / "env" / "bin" / "avrgym", "doctor")


def test_skeletons_can_be_installed_and_used(lab: Path) -> None:
    run(lab, *NEW)
    install(lab, *(lab / name for name in PLUGINS))
    run(lab, *WITH_PLUGINS)
    listed = {row["env"] for row in json.loads((lab / "envs.json").read_text())}
    assert {"avrgym/LiftArmJaco-v1", "avrgym/FeedingLongArm-v1", "avrgym/LiftArmLongArm-v1"} <= listed


def test_commands_that_need_no_study_work(lab: Path) -> None:
    (lab / "little.toml").write_text("worlds = 2\nminibatch = 100\n")
    run(lab, *ALONE)


def test_a_study_produces_a_report(lab: Path) -> None:
    run(lab, ["study", "new", "study"])
    design = lab / "study" / "study.toml"
    text = design.read_text()
    for name, value in DESIGN.items():
        text = re.sub(f"^{name} = .*$", f"{name} = {value}", text, flags=re.M)
    design.write_text(text)
    run(lab, *OF_A_STUDY)
    for lost in (lab / "study").glob("study.db*"):
        lost.unlink()
    run(lab, REBUILD)
    assert (lab / "study" / "analysis" / "report" / "index.html").stat().st_size > 1000


@pytest.mark.parametrize("words", SERVERS, ids=lambda words: words[0])
def test_servers_serve(words: list[str], lab: Path) -> None:
    command = [str(python(lab)), *command_with_limits(*RELAXED_LIMITS)[1:], *words]
    with subprocess.Popen(command, cwd=lab, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert any("#token=" in line for line in process.stdout)
        finally:
            process.terminate()


# The core, without extras


@pytest.fixture(scope="module")
def core(lab: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the virtual environment ``env``: the wheel, and links to what it requires without extras."""
    folder = tmp_path_factory.mktemp("core")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    site = Path(sysconfig.get_path("purelib", vars={"base": str(folder / "env")}))
    for name in required():
        files = metadata.files(name) or ()
        for top in {file.parts[0] for file in files} - {"..", "__pycache__"}:
            if not (site / top).exists():
                (site / top).symlink_to(str(metadata.distribution(name).locate_file(top)))
    install(folder, *lab.glob("*.whl"))
    return folder


ENVIRONMENTS = """
import gymnasium as gym

import avrgym

for name in [name for name in gym.registry if name.startswith("avrgym/")]:
    with gym.make(name, render_mode="rgb_array") as env:
        env.reset(seed=0)
        env.step(env.action_space.sample())
        try:
            assert env.render().ndim == 3
        except RuntimeError as error:
            assert "pip install avrgym[vr]" in str(error) and "Jaco" not in name and "PR2" not in name
gym.make_vec("avrgym/FeedingJaco-v1", num_envs=2).reset(seed=0)
"""


def test_the_core_has_few_requirements() -> None:
    own = [each for each in metadata.requires("avrgym") or () if "extra ==" not in each]
    assert len(own) <= 9


def test_the_core_runs_environments_and_policies(core: Path) -> None:
    called(core, python(core), "-c", ENVIRONMENTS)
    evaluated = ["evaluate", FEEDING, "--policy", "adaptive", "--people", "zoo/unseen", "--episodes", "1"]
    run(core, ["envs"], evaluated, ["export", "scene", FEEDING, "scene"])


@pytest.mark.parametrize(
    ("words", "extra"),
    [
        ("study new x", "study"),
        ("analyze x", "study"),
        ("fit-people x --out y", "study"),
        ("demo", "study"),
        ("serve", "vr"),
        (f"view {FEEDING}", "vr"),
        ("replay x.mcap", "vr"),
        ("doctor", "vr"),
        ("bench vr", "vr"),
        (f"train {FEEDING}", "train"),
        (f"train {FEEDING} --recipe adaptive", "train"),
        ("sweep x.toml --out y", "train,cluster"),
        (f"export policy original {FEEDING} x.onnx", "onnx"),
        (f"evaluate {FEEDING} --cluster local", "cluster"),
    ],
)
def test_commands_name_the_extra_that_is_missing(words: str, extra: str, core: Path) -> None:
    ran = subprocess.run([core / "env/bin/avrgym", *words.split()], cwd=core, capture_output=True, text=True)
    assert (ran.returncode, ran.stdout) == (1, "")
    (line,) = ran.stderr.splitlines()
    assert re.fullmatch(rf"avrgym: \w+ is missing; run `pip install 'avrgym\[{extra}\]'`", line)
    assert not [*core.glob("x*"), *core.glob("y*")]
