"""Packages to begin with: installed as they are written, they pass their own tests and are wherever ours are."""

import compileall
import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from avrgym.cli.main import app
from avrgym.skeletons import package_files
from avrgym.skeletons.package_files import TEMPLATE_NAMES, make_module_name, make_package_name
from avrgym.tasks.constants import PACKAGED_TASKS
from helpers.system.example_package import avrgym, environment_variables, python

SKELETONS = Path(package_files.__file__).parent
NAMES = {"task": "RollUpSleeve", "robot": "LongArm2", "controller": "LetGo"}


def new(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, ["new", *map(str, arguments)])


def files_in(folder: Path) -> dict[Path, str]:
    """The texts of a folder, without what Python compiled of them."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    return {path.relative_to(folder): path.read_text() for path in paths}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one package of each kind, as they are written and as pip installs them, into a path with spaces."""
    folder = tmp_path_factory.mktemp("of my own")
    for kind, name in NAMES.items():
        written = new(kind, name, "--out", folder / kind)
        assert written.exit_code == 0, written.output
    offline = ("--quiet", "--no-index", "--no-deps", "--no-build-isolation")
    command = [sys.executable, "-m", "pip", "install", *offline, "--target", folder]
    subprocess.run([*command, *(folder / kind for kind in NAMES)], check=True, timeout=300)
    return folder


@pytest.mark.slow
def test_each_template_passes_its_own_tests(installed: Path) -> None:
    tests = [str(installed / kind / "tests") for kind in NAMES]
    python(installed, "-m", "pytest", "-q", "-p", "no:cacheprovider", *tests)


@pytest.mark.slow
def test_each_template_is_listed_with_the_packaged_ones(installed: Path) -> None:
    avrgym(installed, "envs", "--json", "envs.json")
    listed = {row["env"] for row in json.loads((installed / "envs.json").read_text())}
    assert {f"avrgym/{task}LongArm2-v1" for task in PACKAGED_TASKS} <= listed
    assert {f"avrgym/RollUpSleeve{robot}-v1" for robot in ("Jaco", "PR2", "LongArm2")} <= listed
    asked = [sys.executable, "-c", "from avrgym.cli import app; app()", "evaluate"]
    refused = subprocess.run(
        [*asked, "avrgym/FeedingJaco-v1", "--policy", "none-such"],
        env=environment_variables(installed), cwd=installed, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert "let-go" in refused.stderr


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("kind", NAMES)
def test_nothing_of_the_template_s_name_is_left(kind: str, installed: Path) -> None:
    written = files_in(installed / kind)
    assert Path("src", make_module_name(NAMES[kind]), "__init__.py") in written
    for spelt in (str, make_module_name, make_package_name):
        name = spelt(TEMPLATE_NAMES[kind])  # type: ignore[index]
        assert [path for path, text in written.items() if name in f"{path} {text}"] == []
    project = tomllib.loads(written[Path("pyproject.toml")])["project"]
    assert project["name"] == make_package_name(NAMES[kind])


@pytest.mark.parametrize(
    ("name", "spelt"), [("LiftArm", "lift_arm"), ("UR5", "ur5"), ("Gen3Lite", "gen3_lite"), ("A", "a")]
)
def test_a_name_is_spelt_as_python_spells_modules(name: str, spelt: str) -> None:
    assert make_module_name(name) == spelt


@pytest.mark.parametrize(
    ("kind", "name", "reason"),
    [
        ("task", "lift-arm", "a capital letter"),
        ("task", "Lift Arm", "a capital letter"),
        ("task", "Ärmel", "a capital letter"),
        ("task", "../Up", "a capital letter"),
        ("robot", "", "a capital letter"),
        ("task", "Feeding", "there is already a task Feeding"),
        ("robot", "Jaco", "there is already a robot Jaco"),
        ("controller", "Oracle", "there is already a controller Oracle"),
        ("controller", "Revised", "there is already a controller Revised"),
        ("controller", "Operator", "there is already a controller Operator"),
        ("task", "Class", "a Python module class already exists"),
        ("controller", "Json", "a Python module json already exists"),
        ("robot", "Mujoco", "a Python module mujoco already exists"),
    ],
)
def test_an_invalid_name_is_rejected_and_nothing_is_written(
    kind: str, name: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    refused = new(kind, name)
    assert (refused.exit_code, len(refused.stderr.splitlines())) == (1, 1)
    assert reason in refused.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("there", ["file", "folder", "link"])
def test_existing_folders_are_never_changed(there: str, tmp_path: Path) -> None:
    out = tmp_path / "mine"
    if there == "file":
        out.write_text("kept")
    elif there == "folder":
        out.mkdir()
    else:
        out.symlink_to(tmp_path / "nowhere")
    before = out.lstat()
    refused = new("task", "LiftArm", "--out", out)
    assert refused.exit_code == 1
    assert refused.stderr.strip() == f"avrgym: {out} already exists; choose another --out"
    assert out.lstat().st_mtime_ns == before.st_mtime_ns
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, small_files) -> None:
    small_files(100)
    refused = new("task", "LiftArm", "--out", tmp_path / "mine")
    small_files(0)
    assert refused.exit_code == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("next_to_sources", [False, True])
@pytest.mark.parametrize("kind", NAMES)
def test_templates_that_were_compiled_give_the_same_package(
    kind: str, next_to_sources: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    template = SKELETONS / "templates" / kind
    clean = shutil.ignore_patterns("__pycache__")
    copy = Path(shutil.copytree(template, tmp_path / "templates" / kind, ignore=clean))
    sources = {path.relative_to(copy) for path in copy.rglob("*") if path.is_file()}
    compileall.compile_dir(copy, quiet=1, legacy=next_to_sources)
    assert list(copy.rglob("*.pyc"))
    monkeypatch.setattr(package_files, "files", lambda _package: tmp_path)
    written = new(kind, NAMES[kind], "--out", tmp_path / "mine")
    assert written.exit_code == 0, written.output
    found = [path for path in (tmp_path / "mine").rglob("*") if path.is_file()]
    assert len(found) == len(sources)
    assert all(path.suffix != ".pyc" for path in found)
