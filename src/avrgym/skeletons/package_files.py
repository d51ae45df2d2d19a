"""Writes packages from templates, for the command ``avrgym new``."""

import importlib.util
import keyword
import re
import shutil
from collections.abc import Collection, Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Literal

from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.policies.registry import list_policy_names
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.registry import ENVIRONMENTS, TASKS

PackageKind = Literal["task", "robot", "controller"]
TEMPLATE_NAMES: Mapping[PackageKind, str] = {
    "task": "TouchElbow",
    "robot": "ExampleArm",
    "controller": "WaveArm",
}
"""Name of the example task, robot or controller in each template. The new name replaces it."""
TEMPLATE_SUFFIXES = (".md", ".py", ".toml", ".xml")
"""Suffixes of template files. Installers add files with other suffixes, such as compiled Python files."""
NAME_PATTERN = re.compile(r"[A-Z][A-Za-z0-9]*")


def write_plugin_package(kind: PackageKind, name: str, out: Path | None = None) -> list[Path]:
    """Write a package with a task, a robot or a controller.

    Args:
        kind: content of the package: a task, a robot or a controller.
        name: name of the task, robot or controller: a capital letter, then letters and digits, such as ``LiftArm``.
        out: a new folder; ``lift-arm`` in the working directory by default.

    Returns:
        The paths of the written files.

    Raises:
        ValueError: for an invalid name or an existing folder.
        OSError: if a file cannot be written; partial output is removed.
    """
    check_plugin_name(kind, name)
    folder = out or Path(make_package_name(name))
    try:
        folder.mkdir()
    except FileExistsError:
        raise ValueError(f"{folder} already exists; choose another --out") from None
    try:
        return list(_written(kind, name, folder))
    except BaseException:
        shutil.rmtree(folder)
        raise


def check_plugin_name(kind: PackageKind, name: str) -> None:
    """Raises ``ValueError`` for an invalid or used name of a task, robot or controller."""
    if not NAME_PATTERN.fullmatch(name) or not name.isascii():
        raise ValueError(
            f"{name!r} cannot be the name of a {kind}; allowed: a capital letter, then letters and "
            f"digits, such as LiftArm"
        )
    if (make_package_name(name) if kind == "controller" else name) in _taken(kind):
        raise ValueError(f"there is already a {kind} {name}; allowed: another name")
    if (
        keyword.iskeyword(make_module_name(name))
        or importlib.util.find_spec(make_module_name(name)) is not None
    ):
        raise ValueError(
            f"a Python module {make_module_name(name)} already exists; allowed: a name without an existing module"
        )


def _taken(kind: PackageKind) -> Collection[str]:
    if kind == "controller":
        return (*list_policy_names(next(iter(ENVIRONMENTS))), OPERATOR_POLICY_NAME)
    return TASKS if kind == "task" else ROBOTS


def make_module_name(name: str) -> str:
    """Returns the module name of a task, robot or controller: ``lift_arm`` for ``LiftArm``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def make_package_name(name: str) -> str:
    """Returns the package name of a task, robot or controller: ``lift-arm`` for ``LiftArm``."""
    return make_module_name(name).replace("_", "-")


def _written(kind: PackageKind, name: str, folder: Path) -> Iterator[Path]:
    template = files("avrgym.skeletons").joinpath("templates", kind)
    for parts, text in _texts(template):
        path = folder.joinpath(*(_renamed(part, kind, name) for part in parts))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_renamed(text, kind, name), "utf-8")
        yield path


def _texts(folder: Traversable, *parents: str) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yields the template files in a folder and its subfolders: path parts and text."""
    for each in sorted(folder.iterdir(), key=lambda each: each.name):
        if each.is_dir():
            yield from _texts(each, *parents, each.name)
        elif each.name.endswith(TEMPLATE_SUFFIXES):
            yield (*parents, each.name), each.read_text("utf-8")


def _renamed(text: str, kind: PackageKind, name: str) -> str:
    template = TEMPLATE_NAMES[kind]
    for spelt in (str, make_module_name, make_package_name):
        text = text.replace(spelt(template), spelt(name))
    return text
