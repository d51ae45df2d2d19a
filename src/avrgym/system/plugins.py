"""Plug-ins: objects that other installed packages register by entry points.

A broken package does not stop AVR Gym. Plug-ins that cannot be loaded are skipped, with a warning of the logger
``avrgym.plugins``.
"""

import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, TypeVar


class Named(Protocol):
    """An object with a name, as plug-ins register it."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)
TASKS, ROBOTS, CONTROLLERS = "avrgym.tasks", "avrgym.robots", "avrgym.controllers"
"""The groups of entry points."""
_LOG = logging.getLogger("avrgym.plugins")
_loaded: dict[tuple[str, str], EntryPoint] = {}
"""Entry points of loaded objects, by group and name."""


@dataclass(frozen=True)
class SkippedPlugin:
    """A skipped entry point, as ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``, and the reason."""

    name: str
    reason: str


def load(group: str, kind: type[T], add: Callable[[T], object]) -> list[SkippedPlugin]:
    """Call ``add`` with every object of a type that installed packages register in a group, sorted by name.

    Returns:
        The entry points that cannot be loaded, have another type, or for which ``add`` raises an exception.
    """
    broken: list[SkippedPlugin] = []
    for entry in entries(group):
        try:
            found = _object(entry, kind)
            add(found)
            _loaded[group, found.name] = entry
        except (Exception, SystemExit) as error:  # plug-ins may raise anything
            broken.append(skip(described(entry), error))
    return broken


def entry_of(group: str, name: str) -> EntryPoint | None:
    """The entry point of a loaded object; ``None`` if it is not a plug-in."""
    return _loaded.get((group, name))


@cache
def entries(group: str) -> tuple[EntryPoint, ...]:
    """The entry points of a group, sorted by name; cached, without imports."""
    return tuple(sorted(entry_points(group=group), key=described))


def described(entry: EntryPoint) -> str:
    """An entry point as ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``."""
    package = "" if entry.dist is None else f" ({entry.dist.name} {entry.dist.version})"
    return f"{entry.name} = {entry.value}{package}"


def skip(name: str, error: BaseException) -> SkippedPlugin:
    """Log a warning that a plug-in is skipped because of an error."""
    broken = SkippedPlugin(name, f"{type(error).__name__}: {error}")
    _LOG.warning("skipped %s: %s", broken.name, broken.reason)
    return broken


def _object(entry: EntryPoint, kind: type[T]) -> T:
    spec = getattr(sys.modules.get(entry.module), "__spec__", None)
    if getattr(spec, "_initializing", False):
        raise ImportError(f"{entry.module} was imported before avrgym; import avrgym first")
    found = entry.load()
    if not isinstance(found, kind):
        raise TypeError(f"{entry.value} is a {type(found).__name__}; allowed: a {kind.__name__}")
    return found
