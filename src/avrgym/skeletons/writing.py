"""Write template packages for ``avrgym new``."""

import importlib.util
import keyword
import re
import shutil
from collections.abc import Collection, Iterator, Mapping
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Literal

from avrgym.policies.names import OPERATOR
from avrgym.policies.registry import named_policies
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.registry import ENVIRONMENTS, TASKS

Kind = Literal["task", "robot", "controller"]
TEMPLATES: Mapping[Kind, str] = {"task": "TouchElbow", "robot": "ExampleArm", "controller": "WaveArm"}
"""Name of the example in each template. The new name replaces it."""
TEMPLATE_FILES = (".md", ".py", ".toml", ".xml")
"""Suffixes of template files. Installers add files with other suffixes, such as compiled Python files."""
NAME = re.compile(r"[A-Z][A-Za-z0-9]*")


def write_skeleton(kind: Kind, name: str, out: Path | None = None) -> list[Path]:
    """Write a package with a task, a robot or a controller.

    Args:
        kind: content of the package.
        name: a capital letter, then letters and digits, such as ``LiftArm``.
        out: a new folder; ``lift-arm`` in the working directory by default.

    Returns:
        The paths of the written files.

    Raises:
        ValueError: for an invalid name or an existing folder.
        OSError: if a file cannot be written; partial output is removed.
    """
    check_name(kind, name)
    folder = out or Path(distribution(name))
    try:
        folder.mkdir()
    except FileExistsError:
        raise ValueError(f"{folder} already exists; choose another --out") from None
    try:
        return list(_written(kind, name, folder))
    except BaseException:
        shutil.rmtree(folder)
        raise


def check_name(kind: Kind, name: str) -> None:
    """Raise ``ValueError`` for an invalid or used name of a task, robot or controller."""
    if not NAME.fullmatch(name) or not name.isascii():
        raise ValueError(
            f"{name!r} cannot be the name of a {kind}; allowed: a capital letter, then letters and "
            f"digits, such as LiftArm"
        )
    if (distribution(name) if kind == "controller" else name) in _taken(kind):
        raise ValueError(f"there is already a {kind} {name}; allowed: another name")
    if keyword.iskeyword(module(name)) or importlib.util.find_spec(module(name)) is not None:
        raise ValueError(
            f"a Python module {module(name)} already exists; allowed: a name without an existing module"
        )


def _taken(kind: Kind) -> Collection[str]:
    if kind == "controller":
        return (*named_policies(next(iter(ENVIRONMENTS))), OPERATOR)
    return TASKS if kind == "task" else ROBOTS


def module(name: str) -> str:
    """Returns the module name of a task, robot or controller: ``lift_arm`` for ``LiftArm``."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()


def distribution(name: str) -> str:
    """Returns the package name of a task, robot or controller: ``lift-arm`` for ``LiftArm``."""
    return module(name).replace("_", "-")


def _written(kind: Kind, name: str, folder: Path) -> Iterator[Path]:
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
        elif each.name.endswith(TEMPLATE_FILES):
            yield (*parents, each.name), each.read_text("utf-8")


def _renamed(text: str, kind: Kind, name: str) -> str:
    template = TEMPLATES[kind]
    for spelt in (str, module, distribution):
        text = text.replace(spelt(template), spelt(name))
    return text
