"""The hash of a plug-in covers every file that determines its behaviour, and no other file."""

import json
import sys
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.learning.evaluation import evaluate
from avrgym.policies import controllers, registry
from avrgym.policies.trained_policies import Policy
from avrgym.system import plugins, used_plugins
from avrgym.system.used_plugins import (
    UsedPlugin,
    compute_module_sha256,
    describe_plugin_differences,
    get_avrgym_version,
)
from avrgym.tasks.registry import find_plugins
from helpers.learning.random_networks import random_network, save_network
from helpers.system.fake_plugins import change, register
from helpers.vr.visit import ENVIRONMENT

FILES = {
    "arm/__init__.py": "",
    "arm/robot.py": "import numpy\nfrom arm import joints\nimport shared\nimport tools.grips\n",
    "arm/joints.py": "COUNT = 7\n",
    "arm/model/arm.xml": "<mujoco/>",
    "arm/model/hand.stl": "solid",
    "shared.py": "SPEED = 1.0\n",
    "tools/__init__.py": "",
    "tools/grips.py": "WIDTH = 0.1\n",
}
OTHERS = ("other.py", "arm/__pycache__/robot.cpython-311.pyc", "arm/old.pyc", "arm/.DS_Store", "notes.txt")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, text in FILES.items():
        write(tmp_path / name, text)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in [
        name for name in sys.modules if name.partition(".")[0] in ("arm", "shared", "tools", "mine")
    ]:
        del sys.modules[name]
    return tmp_path


def write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def content(module: str = "arm.robot") -> str:
    """The hash, as a new process finds it."""
    compute_module_sha256.cache_clear()
    return compute_module_sha256(module)


@pytest.mark.parametrize("name", FILES)
def test_the_hash_includes_the_package_and_its_neighbours(folder: Path, name: str) -> None:
    before = content()
    (folder / name).write_text(FILES[name] + "\n")
    assert content() != before
    (folder / name).write_text(FILES[name])
    assert content() == before
    (folder / name).rename(folder / f"{name}.moved")
    assert content() != before


@pytest.mark.parametrize("name", OTHERS)
def test_the_hash_includes_no_other_files(folder: Path, name: str) -> None:
    before = content()
    write(folder / name, "anything")
    assert content() == before


def test_a_module_without_a_package_is_hashed_with_its_imports(folder: Path) -> None:
    write(folder / "mine.py", "import shared\n")
    before = content("mine")
    write(folder / "arm" / "joints.py", "COUNT = 6\n")
    assert content("mine") == before
    write(folder / "shared.py", "SPEED = 2.0\n")
    assert content("mine") != before


def test_the_place_of_the_files_does_not_count_and_neighbours_among_installed_packages_do_not(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = content()
    moved = folder.rename(folder.with_name("elsewhere"))
    monkeypatch.syspath_prepend(str(moved))
    assert content() == before
    (moved / "numpy-2.0.dist-info").mkdir()
    alone = content()
    write(moved / "shared.py", "SPEED = 3.0\n")
    assert content() == alone


def test_unreadable_files_have_no_hash() -> None:
    assert content("sys") == content("none_such.robot") == ""


A, B = (
    UsedPlugin("robot", "Arm", "arm = arm:ARM", "arm", "1.0", "a" * 64),
    UsedPlugin("task", "Lift", "l = l:L"),
)


def test_differences_list_changed_and_missing_plugins() -> None:
    changed = msgspec.structs.replace(A, sha256="b" * 64)
    assert describe_plugin_differences([A, B], [B, A]) == []
    assert describe_plugin_differences([A], [changed]) == [
        "robot Arm was arm 1.0 (content aaaaaaaaaaaa), is arm 1.0 (content bbbbbbbbbbbb)"
    ]
    assert describe_plugin_differences([], [A]) == [
        "robot Arm was not stored, is arm 1.0 (content aaaaaaaaaaaa)"
    ]
    assert describe_plugin_differences([A], []) == [
        "robot Arm was arm 1.0 (content aaaaaaaaaaaa), is not a plug-in here"
    ]


@pytest.mark.parametrize(
    ("origin", "expected"),
    [
        (None, "1.2"),
        ('{"url": "https://a/b.whl", "archive_info": {}}', "1.2"),
        ('{"url": "file:///a", "dir_info": {"editable": true}}', "1.2+012345678901"),
    ],
)
def test_the_version_of_an_editable_installation_contains_a_hash(
    origin: str | None, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    about = SimpleNamespace(version="1.2", read_text=lambda name: origin)
    monkeypatch.setattr("importlib.metadata.distribution", lambda name: about)
    monkeypatch.setattr(used_plugins, "compute_module_sha256", lambda module: "0123456789" * 6)
    get_avrgym_version.cache_clear()
    assert get_avrgym_version() == expected
    get_avrgym_version.cache_clear()


# Policies


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return register(monkeypatch, tmp_path / "lab", plugins.ROBOT_ENTRY_POINT_GROUP, "Jaco")


def policy(used: tuple[UsedPlugin, ...]) -> Policy:
    found = random_network(ENVIRONMENT, of_human=False)
    metadata = msgspec.structs.replace(found.metadata, plugins=used)
    return Policy(**{**vars(found), "metadata": metadata})


def test_a_policy_s_file_stores_the_plug_ins_of_its_environment(robot: Path, tmp_path: Path) -> None:
    (used,) = find_plugins(ENVIRONMENT)
    assert (used.label, used.package, used.version) == ("robot Jaco", "lab-robots", "1.0")
    assert used.entry_point == "jaco = lab_robots.robot:ROBOT"
    read = Policy.load(save_network(tmp_path / "a.safetensors", policy((used,))))
    assert read.metadata.plugins == (used,)
    assert registry.describe_plugin_changes(read, ENVIRONMENT) == []
    change(robot)
    (difference,) = registry.describe_plugin_changes(read, ENVIRONMENT)
    assert difference.startswith("robot Jaco was lab-robots 1.0 (content ")


def test_files_of_built_in_robots_are_as_they_were(tmp_path: Path) -> None:
    path = save_network(tmp_path / "a.safetensors", policy(()))
    assert b"plugins" not in Path(path).read_bytes()
    assert Policy.load(path).metadata.plugins == ()
    assert registry.describe_plugin_changes(Policy.load(path), ENVIRONMENT) == []


def test_evaluation_lists_differing_plugins(robot: Path, tmp_path: Path) -> None:
    same, old = policy(find_plugins(ENVIRONMENT)), policy(())
    files = [
        save_network(tmp_path / f"{name}.safetensors", each) for name, each in (("same", same), ("old", old))
    ]
    rows = [evaluate(ENVIRONMENT, file, "original", 1, 0, steps=1) for file in files]
    assert rows[0].plugin_differences == []
    assert rows[1].plugin_differences[0].startswith("robot Jaco was not stored, is lab-robots 1.0 (content ")
    change(robot)
    asked = [
        "evaluate",
        ENVIRONMENT,
        "--policy",
        files[0],
        "--people",
        "original",
        "--episodes",
        "1",
        "--episode-steps",
        "1",
        "--jobs",
        "1",
    ]
    ran = CliRunner().invoke(app, [*asked, "--json", str(tmp_path / "rows.json")])
    assert ran.exit_code == 0
    (row,) = json.loads((tmp_path / "rows.json").read_text())
    (difference,) = row["plugin_differences"]
    assert difference.startswith("robot Jaco was lab-robots 1.0 (content ")
    assert f"with original: differs from the policy's training: {difference}\n" in ran.stderr


# Controllers


def test_a_controller_s_code_is_stored_and_a_network_s_file_is_none(folder: Path) -> None:
    write(folder / "still.py", "class Still:\n    def reset(self, *a): ...\n    def act(self, o): ...\n")
    found = controllers.import_python_controller("still:Still")
    assert found.plugin is not None
    assert (found.plugin.label, found.plugin.sha256) == ("controller still:Still", content("still"))
    assert registry.find_used_plugins(ENVIRONMENT, found) == (found.plugin,)
    assert registry.find_used_plugins(ENVIRONMENT, registry.ScriptedPolicy("oracle")) == ()


@pytest.mark.slow
def test_training_stores_the_plugins(robot: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from avrgym.learning import training
    from avrgym.learning.configuration import FeedforwardConfiguration

    monkeypatch.setattr(training, "EVALUATION_EPISODES", 1)
    configuration = FeedforwardConfiguration(
        environment=ENVIRONMENT, steps=200, num_envs=1, imitation_rounds=0
    )
    assert training.train(configuration, tmp_path / "out").metadata.plugins == find_plugins(ENVIRONMENT)
