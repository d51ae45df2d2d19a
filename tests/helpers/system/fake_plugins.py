"""Registers built-in robots or tasks as plug-ins of a package ``lab-robots``."""

import sys
from importlib.metadata import Distribution, EntryPoint
from pathlib import Path

import pytest

from avrgym.system import plugins
from avrgym.system.used_plugins import compute_module_sha256

MODULE = "lab_robots"


def register(patch: pytest.MonkeyPatch, folder: Path, group: str, name: str) -> Path:
    """Register a robot or task from a package in the folder. Returns the file of its module."""
    package = folder / "src" / MODULE
    about = folder / "site" / f"{MODULE}-1.0.dist-info"
    package.mkdir(parents=True)
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-robots\nVersion: 1.0\n")
    (package / "__init__.py").write_text("")
    (package / "robot.py").write_text("SPEED = 1.0\n")
    patch.syspath_prepend(str(folder / "src"))
    patch.delitem(sys.modules, MODULE, raising=False)
    entry = EntryPoint(name.lower(), f"{MODULE}.robot:ROBOT", group)
    vars(entry)["dist"] = Distribution.at(about)
    patch.setitem(plugins._loaded, (group, name), entry)
    compute_module_sha256.cache_clear()
    return package / "robot.py"


def change(module: Path) -> None:
    """Change the plug-in's source, and clear the cached checksum."""
    module.write_text("SPEED = 2.0\n")
    compute_module_sha256.cache_clear()
