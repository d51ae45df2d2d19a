"""Controllers that others write: anything that turns the observations of one robot into actions."""

import copy
import importlib
import importlib.util
import inspect
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.policies.trained import PolicyError
from avrgym.system import plugins
from avrgym.system.used_plugins import UsedPlugin, used_entry, used_python

MOST_WORDS = 160
"""How many characters of an exception are told."""


class Controller(Protocol):
    """What drives one robot through one episode after another. It may also have a method ``close()``."""

    def reset(self, seed: int, environment: str) -> None:
        """Begin an episode of an environment, such as ``avrgym/FeedingJaco-v1``; all chance follows the seed."""
        ...

    def act(self, observation: FloatArray) -> ArrayLike:
        """The action (A,) for an observation (O,), float64: each joint's speed as a share, -1 to 1, of its limit."""
        ...


class ControllerError(RuntimeError):
    """A controller gave no action that a robot can follow. The words begin with the kind of failure.

    ``exception``, ``wrong_shape``, ``not_finite`` or ``late``, then a colon.
    """


@dataclass(frozen=True, eq=False)
class Foreign:
    """A controller of somebody else's, by its name; ``make`` makes one more that shares nothing with the others.

    ``plugin`` is what it is now, where it is code.
    """

    name: str
    make: Callable[[], Controller]
    plugin: UsedPlugin | None = None


def reset(controller: Controller, seed: int, environment: str) -> None:
    """Begin an episode; ``ControllerError`` where the controller raises."""
    try:
        controller.reset(seed, environment)
    except (Exception, SystemExit) as error:  # other people's code may raise anything
        raise as_failure(error) from error


def answer(controller: Controller, observation: FloatArray, size: int) -> FloatArray:
    """A controller's action (size,) for an observation (O,), within -1 to 1.

    Raises:
        ControllerError: where it raises, or answers anything but so many finite numbers.
    """
    return checked(lambda: controller.act(np.array(observation, float)), (size,))


def checked(act: Callable[[], ArrayLike], shape: tuple[int, ...]) -> FloatArray:
    """What ``act`` gives, within -1 to 1; ``ControllerError`` where it raises or is no action of this shape."""
    try:
        action = np.array(act(), float)
    except (Exception, SystemExit) as error:  # other people's code may raise anything
        raise as_failure(error) from error
    if action.shape != shape:
        raise ControllerError(f"wrong_shape: {action.shape}; allowed: {shape}")
    if not np.isfinite(action).all():
        raise ControllerError(f"not_finite: {action.tolist()}; allowed: finite numbers, -1 to 1")
    return np.clip(action, -1.0, 1.0)


def close(controller: Controller) -> None:
    """Let a controller go, if it wants to know."""
    end = getattr(controller, "close", None)
    if end is not None:
        end()


def find_python(name: str) -> Foreign:
    """The controller that ``module:attribute`` names.

    A class, a function that makes one, one that is copied, or a function from an observation to an action.

    Modules are found as Python finds them, and in the folder where the program runs.

    Raises:
        PolicyError: where there is none.
    """
    module, _, attribute = name.partition(":")
    _search_here()
    try:
        found = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # a module may raise anything
        raise PolicyError(f"{name}: cannot be imported ({_words(error)})") from error
    return _foreign(name, found, used_python(name))


def python_file(name: str) -> Path | None:
    """The file of the module that ``module:attribute`` names, if there is one; the module itself is not imported."""
    _search_here()
    try:
        spec = importlib.util.find_spec(name.partition(":")[0])
    except Exception:  # a package that the module lies in may raise anything
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _search_here() -> None:
    """Let Python find modules in the folder where the program runs."""
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)


def registered() -> dict[str, EntryPoint]:
    """The controllers that other packages register, by name; none of them is imported yet."""
    return {entry.name: entry for entry in plugins.entries(plugins.CONTROLLERS)}


def find_registered(name: str) -> Foreign:
    """A registered controller; ``PolicyError`` where its package is broken."""
    entry = registered()[name]
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:  # a package may raise anything
        raise PolicyError(f"{plugins.described(entry)}: cannot be imported ({_words(error)})") from error
    return _foreign(name, found, used_entry("controller", name, entry))


def plugin_named(name: str) -> UsedPlugin | None:
    """The registered controller or the ``module:attribute`` of a name as it is now; ``None`` for another name."""
    if name in registered():
        return used_entry("controller", name, registered()[name])
    return used_python(name) if ":" in name else None


def broken() -> list[str]:
    """Which registered controllers cannot be imported or made, and why; this imports them all."""
    reasons: list[str] = []
    for name in registered():
        try:
            find_registered(name)
        except PolicyError as error:
            reasons.append(str(error))
    return reasons


@dataclass(frozen=True)
class _Function:
    """A controller without memory: a function from an observation to an action."""

    act: Callable[[FloatArray], ArrayLike]

    def reset(self, seed: int, environment: str) -> None:
        """Nothing: it remembers nothing."""


def _takes_observation(found: Any) -> bool:
    """Whether a function cannot be called without an argument, and can with one: the observation."""
    if isinstance(found, type) or not callable(found) or hasattr(found, "act"):
        return False
    try:
        signature = inspect.signature(found)
    except ValueError:  # compiled functions may have none
        return False
    return not _can_bind(signature, 0) and _can_bind(signature, 1)


def _can_bind(signature: inspect.Signature, count: int) -> bool:
    try:
        signature.bind(*range(count))
    except TypeError:
        return False
    return True


def _foreign(name: str, found: Any, plugin: UsedPlugin) -> Foreign:
    """Make one at once: what cannot be made is refused before anybody waits for it."""
    if _takes_observation(found):
        found = _Function(found)
    ready_made = not isinstance(found, type) and hasattr(found, "act")

    def make() -> Controller:
        try:
            controller: Any = copy.deepcopy(found) if ready_made else found()
        except (Exception, SystemExit) as error:  # other people's code may raise anything
            raise PolicyError(f"{name}: cannot be made ({_words(error)})") from error
        lacking = [each for each in ("reset", "act") if not callable(getattr(controller, each, None))]
        if lacking:
            raise PolicyError(
                f"{name}: a {type(controller).__name__} without {' and '.join(lacking)}; "
                "a controller has reset(seed, environment) and act(observation)"
            )
        return controller

    close(make())
    return Foreign(name, make, plugin)


def as_failure(error: BaseException) -> ControllerError:
    """How a failure of any kind is told."""
    return error if isinstance(error, ControllerError) else ControllerError(f"exception: {_words(error)}")


def _words(error: BaseException) -> str:
    """An exception in one line that any terminal, recording and database can hold."""
    line = " ".join(f"{type(error).__name__}: {error}".split())
    return "".join(sign if sign.isprintable() else "?" for sign in line)[:MOST_WORDS]
