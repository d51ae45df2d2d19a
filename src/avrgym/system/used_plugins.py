"""Plug-ins of a recording, study or training run: package, version, and hash of the files.

Robots and tasks of AVR Gym are not plug-ins. AVR Gym's version identifies them, see ``get_avrgym_version``.
"""

import ast
import hashlib
import importlib.metadata
import importlib.util
import json
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Literal

import msgspec

PluginKind = Literal["task", "robot", "controller"]
PRINTED_HASH_DIGITS = 12
"""Number of hexadecimal digits of a hash that are printed in texts."""


class UsedPlugin(msgspec.Struct, frozen=True, omit_defaults=True):
    """Identification of a plug-in at the time of its use.

    ``name``: name of the task, robot or controller. ``entry_point``: ``NAME = MODULE:ATTRIBUTE``, or
    ``MODULE:ATTRIBUTE`` for code outside a package; ``package`` and ``version`` are then empty. ``sha256``: hash of the
    plug-in's files, see ``compute_module_sha256``.
    """

    kind: PluginKind
    name: str
    entry_point: str
    package: str = ""
    version: str = ""
    sha256: str = ""

    @property
    def label(self) -> str:
        """Returns kind and name of the plug-in, such as ``robot Gen3``."""
        return f"{self.kind} {self.name}"

    def __str__(self) -> str:
        package = f"{self.package} {self.version}".strip()
        content = f"content {self.sha256[:PRINTED_HASH_DIGITS] or 'unknown'}"
        return f"{package} ({content})" if package else content


@cache
def get_avrgym_version() -> str:
    """Returns the version of AVR Gym. For an editable installation, it includes a hash of the files."""
    about = importlib.metadata.distribution("avrgym")
    origin = json.loads(about.read_text("direct_url.json") or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        return about.version
    return f"{about.version}+{compute_module_sha256('avrgym')[:PRINTED_HASH_DIGITS]}"


def make_plugin_from_entry_point(kind: PluginKind, name: str, entry: EntryPoint) -> UsedPlugin:
    """Returns the used plug-in of an entry point: its package and installed version."""
    about = {} if entry.dist is None else {"package": entry.dist.name, "version": entry.dist.version}
    return UsedPlugin(
        kind, name, f"{entry.name} = {entry.value}", **about, sha256=compute_module_sha256(entry.module)
    )


def make_plugin_from_controller(name: str) -> UsedPlugin:
    """Returns the used plug-in of the controller ``module:attribute``, with a hash of its current files."""
    return UsedPlugin("controller", name, name, sha256=compute_module_sha256(name.partition(":")[0]))


def describe_plugin_differences(before: Iterable[UsedPlugin], now: Iterable[UsedPlugin]) -> list[str]:
    """Returns a text for each plug-in with a different package, version or files in ``before`` and ``now``."""
    old, new = ({each.label: each for each in plugins} for plugins in (before, now))
    return [
        f"{label} was {old.get(label, 'not stored')}, is {new.get(label, 'not a plug-in here')}"
        for label in old | new
        if _content(old.get(label)) != _content(new.get(label))
    ]


def _content(plugin: UsedPlugin | None) -> tuple[str, ...]:
    return () if plugin is None else (plugin.package, plugin.version, plugin.sha256)


@cache
def compute_module_sha256(module: str) -> str:
    """Returns the SHA-256 of a module's files; empty if they cannot be read.

    The files are all files of the module's top-level package, or the file of a module without a package. Imported
    modules and packages in the same folder are included, unless it is a site-packages folder.
    """
    try:
        root = _root(module)
        return "" if root is None else compute_files_sha256(_files(root))
    except OSError:
        return ""


def compute_files_sha256(files: Iterable[tuple[str, Path]]) -> str:
    """Returns the SHA-256 of names and contents of files. Raises ``OSError`` if a file cannot be read."""
    found = hashlib.sha256()
    for name, path in sorted(files):
        data = path.read_bytes()
        found.update(f"{name}\0{len(data)}\0".encode() + data)
    return found.hexdigest()


def _root(module: str) -> Path | None:
    """Returns the folder of the module's outermost package (without namespace packages). Without a package, returns the
    module's file; ``None`` if there is no file.
    """
    parts = module.split(".")
    for count in range(1, len(parts) + 1):
        try:
            spec = importlib.util.find_spec(".".join(parts[:count]))
        except (ImportError, ValueError):
            return None
        if spec is not None and spec.has_location and spec.origin:
            origin = Path(spec.origin)
            return origin if spec.submodule_search_locations is None else origin.parent
    return None


def _files(root: Path) -> list[tuple[str, Path]]:
    """Returns names and paths of the files of a module or package. Modules in the same folder are included if the
    module imports them.
    """
    found = dict[str, Path]()
    places, others = [root], _neighbours(root)
    while places:
        own = list(_files_in(places.pop()))
        found |= {path.relative_to(root.parent).as_posix(): path for path in own}
        names = {name for path in own for name in _imported_names(path)} if others else set[str]()
        places += [others.pop(name) for name in names & others.keys()]
    return list(found.items())


def _files_in(root: Path) -> Iterator[Path]:
    """Yields all files in the folder ``root`` except hidden files and compiled Python files."""
    for path in [root] if root.is_file() else root.rglob("*"):
        names = path.relative_to(root.parent).parts
        hidden = any(name == "__pycache__" or name.startswith(".") for name in names)
        if path.is_file() and path.suffix != ".pyc" and not hidden:
            yield path


def _neighbours(root: Path) -> dict[str, Path]:
    """Returns the other modules and packages in the module's folder, by name; none in a site-packages folder."""
    if any(root.parent.glob("*.dist-info")):
        return {}
    found = {path.stem: path for path in root.parent.glob("*.py")}
    found |= {path.parent.name: path.parent for path in root.parent.glob("*/__init__.py")}
    return {name: path for name, path in found.items() if path != root}


def _imported_names(path: Path) -> set[str]:
    """Returns the top-level names of the modules that a Python file imports."""
    if path.suffix != ".py":
        return set()
    try:
        tree = ast.parse(path.read_bytes())
    except (SyntaxError, ValueError):
        return set()
    names = [
        name
        for node in ast.walk(tree)
        for name in (
            [alias.name for alias in node.names]
            if isinstance(node, ast.Import)
            else [node.module]
            if isinstance(node, ast.ImportFrom) and node.module and not node.level
            else []
        )
    ]
    return {name.partition(".")[0] for name in names}
