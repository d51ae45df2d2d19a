"""What other installed packages register, by entry points (Python Packaging User Guide, "Entry points specification").

A package that is broken must not keep AVR Gym from working: whatever fails is named in a warning of the logger
``avrgym.plugins``, kept in a list to show, and skipped.
"""

import logging
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Protocol, TypeVar


class Named(Protocol):
    """What plug-ins give: something that has a name."""

    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=Named)
TASKS, ROBOTS, CONTROLLERS = "avrgym.tasks", "avrgym.robots", "avrgym.controllers"
"""The groups of entry points."""
_LOG = logging.getLogger("avrgym.plugins")
_loaded: dict[tuple[str, str], EntryPoint] = {}
"""By group and name of what was loaded, the entry point that registers it."""


@dataclass(frozen=True)
class SkippedPlugin:
    """What was skipped, as ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``, and why."""

    name: str
    reason: str


def load(group: str, kind: type[T], add: Callable[[T], object]) -> list[SkippedPlugin]:
    """Give ``add`` every object of a kind that installed packages register in a group, ordered by name.

    Returns:
        What cannot be loaded, is of another kind, or made ``add`` raise an exception.
    """
    broken: list[SkippedPlugin] = []
    for entry in entries(group):
        try:
            found = _object(entry, kind)
            add(found)
            _loaded[group, found.name] = entry
        except (Exception, SystemExit) as error:  # other people's code may raise anything
            broken.append(skip(described(entry), error))
    return broken


def entry_of(group: str, name: str) -> EntryPoint | None:
    """The entry point that registers what was loaded under a name; ``None`` where no other package does."""
    return _loaded.get((group, name))


@cache
def entries(group: str) -> tuple[EntryPoint, ...]:
    """What installed packages register in a group, ordered by name, looked up once; nothing is imported."""
    return tuple(sorted(entry_points(group=group), key=described))


def described(entry: EntryPoint) -> str:
    """An entry point as ``NAME = MODULE:ATTRIBUTE (PACKAGE VERSION)``."""
    package = "" if entry.dist is None else f" ({entry.dist.name} {entry.dist.version})"
    return f"{entry.name} = {entry.value}{package}"


def skip(name: str, error: BaseException) -> SkippedPlugin:
    """Warn that something is left out because of an error."""
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
