"""Files for packaging agree with ``pyproject.toml`` and the robots."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
import rtbdata

from helpers.system.paths import ROOT

PACKAGING = ROOT / "packaging"
AT_CONDA_FORGE = {"mujoco": "mujoco-python", "matplotlib": "matplotlib-base"}
"""Names that differ from the ones at PyPI."""


def project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def test_the_conda_recipe_requires_the_core_and_the_extras_of_studies() -> None:
    recipe = (PACKAGING / "conda" / "recipe.yaml").read_text()
    asked = re.findall(r"^    - (\S+ [<>=]\S+)$", recipe.partition("  run:\n")[2], re.M)
    extras = project()["optional-dependencies"]
    dependencies = [*project()["dependencies"], *extras["vr"], *extras["study"][1:]]
    names = [re.fullmatch(r"([\w-]+)(.*)", each) for each in dependencies]
    expected = [f"{AT_CONDA_FORGE.get(each[1], each[1])} {each[2]}" for each in names if each]
    assert asked == expected
    assert f"  version: {project()['version']}\n" in recipe


@pytest.mark.slow
def test_pruned_robot_data_contain_all_meshes(tmp_path: Path) -> None:
    """Run the script on a copy made of links, which precedes the installed package on the path."""
    copy = Path(shutil.copytree(Path(rtbdata.__path__[0]), tmp_path / "rtbdata", copy_function=os.symlink))
    with_copy = os.environ | {"PYTHON": sys.executable, "PYTHONPATH": str(tmp_path)}
    found = subprocess.check_output(
        [sys.executable, "-c", "import rtbdata; print(rtbdata.__path__[0])"], env=with_copy, text=True
    )
    assert found.strip() == str(copy)
    subprocess.run(
        ["sh", str(PACKAGING / "prune_robot_data.sh")], env=with_copy, check=True, stdout=subprocess.DEVNULL
    )
    assert sorted(path.name for path in (copy / "xacro").iterdir()) == [
        "franka_description",
        "kinova_description",
        "kortex_description",
        "pr2_description",
        "ur_description",
    ]
    shown = "from avrgym.robots.registry import ROBOTS; [robot.build(True).compile() for robot in ROBOTS.values()]"
    subprocess.run([sys.executable, "-c", shown], env=with_copy, check=True)


def test_the_container_does_not_run_as_root() -> None:
    lines = (PACKAGING / "Containerfile").read_text().splitlines()
    user = lines.index("USER 1000")
    assert not any(line.startswith("USER") for line in lines[user + 1 :])
    assert not any(line.startswith("RUN") for line in lines[user:])
    assert all((ROOT / name).is_file() for line in lines for name in re.findall(r"packaging/\S+\.\w+", line))
