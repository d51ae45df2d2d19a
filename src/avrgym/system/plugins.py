"""Plug-ins: tasks, robots and controllers that other packages register by entry points.

A plug-in that cannot be loaded is skipped. The logger ``avrgym.plugins`` then prints a warning.
"""

import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, TypeVar


class NamedObject(Protocol):
    """Interface of an object that a plug-in provides: it has a name."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=NamedObject)
TASK_ENTRY_POINT_GROUP, ROBOT_ENTRY_POINT_GROUP, CONTROLLER_ENTRY_POINT_GROUP = (
    "avrgym.tasks",
    "avrgym.robots",
    "avrgym.controllers",
)
"""Names of the entry point groups of Python packages for tasks, robots and controllers."""
_LOG = logging.getLogger("avrgym.plugins")
_loaded: dict[tuple[str, str], EntryPoint] = {}
"""Entry points of the loaded plug-ins, by group and name of the object."""


@dataclass(frozen=True)
class SkippedPlugin:
    """A skipped plug-in: its entry point as ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``, and the reason."""

    entry_point: str
    reason: str


def load_plugins(group: str, kind: type[T], add: Callable[[T], object]) -> list[SkippedPlugin]:
    """Load all plug-ins of a group, sorted by name. Each must be of type ``kind``. ``add`` is called with each object.

    Returns:
        Plug-ins that cannot be loaded or have another type, or for which ``add`` raises an exception.
    """
    broken: list[SkippedPlugin] = []
    for entry in list_entry_points(group):
        try:
            found = _object(entry, kind)
            add(found)
            _loaded[group, found.name] = entry
        except (Exception, SystemExit) as error:  # plug-ins may raise any exception
            broken.append(log_skipped_plugin(describe_entry_point(entry), error))
    return broken


def find_entry_point(group: str, name: str) -> EntryPoint | None:
    """Returns the entry point of a loaded object; ``None`` if the object is not from a plug-in."""
    return _loaded.get((group, name))


@cache
def list_entry_points(group: str) -> tuple[EntryPoint, ...]:
    """Returns the entry points of a group, sorted by name. The result is cached; nothing is imported."""
    return tuple(sorted(entry_points(group=group), key=describe_entry_point))


def describe_entry_point(entry: EntryPoint) -> str:
    """Returns an entry point as text: ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``."""
    package = "" if entry.dist is None else f" ({entry.dist.name} {entry.dist.version})"
    return f"{entry.name} = {entry.value}{package}"


def log_skipped_plugin(name: str, error: BaseException) -> SkippedPlugin:
    """Log a warning that a plug-in is skipped because of an error. Returns the skipped plug-in."""
    broken = SkippedPlugin(name, f"{type(error).__name__}: {error}")
    _LOG.warning("skipped %s: %s", broken.entry_point, broken.reason)
    return broken


def _object(entry: EntryPoint, kind: type[T]) -> T:
    spec = getattr(sys.modules.get(entry.module), "__spec__", None)
    if getattr(spec, "_initializing", False):
        raise ImportError(f"{entry.module} was imported before avrgym; import avrgym first")
    found = entry.load()
    if not isinstance(found, kind):
        raise TypeError(f"{entry.value} has the type {type(found).__name__}; allowed: {kind.__name__}")
    return found
