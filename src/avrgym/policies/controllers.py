"""Controllers from other packages and files. A controller maps the observations of one robot to actions."""

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
from avrgym.models.cameras import AnyObservation, CameraDescription
from avrgym.policies.trained_policies import PolicyError
from avrgym.system import plugins
from avrgym.system.used_plugins import UsedPlugin, make_plugin_from_controller, make_plugin_from_entry_point

MAX_ERROR_CHARACTERS = 160
"""Maximum length of an exception's text in a message, in characters."""


class Controller(Protocol):
    """Computes the actions of one robot from its observations. It may also have a method ``close()``.

    A controller may have an attribute ``cameras``, a list as in ``gym.make``. Then ``act`` receives a dictionary:
    the entry ``state`` is the observation (O,), and each image has an entry such as ``wrist_rgb``.

    A controller may have an attribute ``takes_commands = True``. Then ``act`` also receives a dictionary. Its entry
    ``command`` is the participant's latest command, see ``safety.pacing.COMMAND_INPUT_ENTRIES``.
    """

    def reset(self, seed: int, environment: str) -> None:
        """Start an episode of an environment, such as ``avrgym/FeedingJaco-v1``. The seed determines all random
        numbers.
        """
        ...

    def act(self, observation: Any) -> ArrayLike:
        """Returns the action (A,) for an observation (O,), float64: joint speeds divided by their limits, -1 to 1."""
        ...


class ControllerError(RuntimeError):
    """Raised if a controller does not return a valid action. The message begins with the kind of failure and a colon.

    The kinds are ``exception``, ``wrong_shape``, ``not_finite`` and ``late``.
    """


def _prepare_nothing() -> None:
    """Does nothing: the default of ``ExternalController.prepare``."""


@dataclass(frozen=True, eq=False)
class ExternalController:
    """A controller of another package or file. ``make_controller`` creates an instance that shares no state with
    other instances.

    ``plugin`` is the installed version of the package; ``None`` for an ONNX file. ``cameras`` lists the cameras that
    the controller needs. ``takes_commands``: whether the controller receives the participant's commands. ``prepare``
    loads data that take long; sessions call it before the first trial.
    """

    name: str
    make_controller: Callable[[], Controller]
    plugin: UsedPlugin | None = None
    cameras: tuple[CameraDescription, ...] = ()
    takes_commands: bool = False
    prepare: Callable[[], None] = _prepare_nothing


def reset_controller(controller: Controller, seed: int, environment: str) -> None:
    """Start an episode of a controller. Raises ``ControllerError`` if the controller raises an exception."""
    try:
        controller.reset(seed, environment)
    except (Exception, SystemExit) as error:  # external code may raise anything
        raise to_controller_error(error) from error


def compute_controller_action(controller: Controller, observation: AnyObservation, size: int) -> FloatArray:
    """Returns a controller's action (size,) for an observation, clipped to -1 to 1.

    Raises:
        ControllerError: if the controller raises an exception, or does not return ``size`` finite numbers.
    """
    own = observation.copy() if isinstance(observation, dict) else np.array(observation, float)
    return compute_checked_action(lambda: controller.act(own), (size,))


def compute_checked_action(act: Callable[[], ArrayLike], shape: tuple[int, ...]) -> FloatArray:
    """Call ``act``. Returns its action with the given shape, clipped to -1 to 1.

    Raises:
        ControllerError: if ``act`` raises an exception, returns another shape, or returns NaN or infinity.
    """
    try:
        action = np.array(act(), float)
    except (Exception, SystemExit) as error:  # external code may raise anything
        raise to_controller_error(error) from error
    if action.shape != shape:
        raise ControllerError(f"wrong_shape: {action.shape}; allowed: {shape}")
    if not np.isfinite(action).all():
        raise ControllerError(f"not_finite: {action.tolist()}; allowed: finite numbers, -1 to 1")
    return np.clip(action, -1.0, 1.0)


def close_controller(controller: Controller) -> None:
    """Call a controller's method ``close``, if it has one."""
    end = getattr(controller, "close", None)
    if end is not None:
        end()


def import_python_controller(name: str) -> ExternalController:
    """Import and return the controller ``module:attribute``.

    The attribute is a controller, or a class or function that creates a controller. It may also be a function that maps
    an observation to an action. A controller object is copied for each use. Python also searches the current folder for
    the module.

    Raises:
        PolicyError: if the controller cannot be imported or created.
    """
    module, _, attribute = name.partition(":")
    _search_current_folder()
    try:
        found = importlib.import_module(module)
        for part in attribute.split("."):
            found = getattr(found, part)
    except (Exception, SystemExit) as error:  # a module may raise anything
        raise PolicyError(
            f"{name}: cannot be imported ({_error_text(error)}); check the name, or correct the error in the module"
        ) from error
    return _external(name, found, make_plugin_from_controller(name))


def find_python_controller_file(name: str) -> Path | None:
    """Returns the file of the module in ``module:attribute``; ``None`` without a file. The module is not imported."""
    _search_current_folder()
    try:
        spec = importlib.util.find_spec(name.partition(":")[0])
    except Exception:  # the module's package may raise anything
        return None
    return Path(spec.origin) if spec is not None and spec.has_location and spec.origin else None


def _search_current_folder() -> None:
    """Append the current folder to Python's search path for modules."""
    folder = os.getcwd()
    if folder not in sys.path:
        sys.path.append(folder)


def find_registered_controllers() -> dict[str, EntryPoint]:
    """Returns the entry points of controllers that other packages register, by name. Nothing is imported."""
    return {entry.name: entry for entry in plugins.list_entry_points(plugins.CONTROLLER_ENTRY_POINT_GROUP)}


def import_registered_controller(name: str) -> ExternalController:
    """Import and return a registered controller. Raises ``PolicyError`` if it cannot be imported or created."""
    entry = find_registered_controllers()[name]
    try:
        found = entry.load()
    except (Exception, SystemExit) as error:  # a package may raise anything
        raise PolicyError(
            f"{plugins.describe_entry_point(entry)}: cannot be imported ({_error_text(error)}); correct the error in "
            "the package, or uninstall the package"
        ) from error
    return _external(name, found, make_plugin_from_entry_point("controller", name, entry))


def find_controller_plugin(name: str) -> UsedPlugin | None:
    """Returns the plug-in of a registered controller or of ``module:attribute``; ``None`` for other names."""
    if name in find_registered_controllers():
        return make_plugin_from_entry_point("controller", name, find_registered_controllers()[name])
    return make_plugin_from_controller(name) if ":" in name else None


def collect_controller_import_errors() -> list[str]:
    """Import all registered controllers. Returns an error message for each controller that cannot be imported or
    created.
    """
    reasons: list[str] = []
    for name in find_registered_controllers():
        try:
            import_registered_controller(name)
        except PolicyError as error:
            reasons.append(str(error))
    return reasons


@dataclass(frozen=True)
class _Function:
    """A controller without memory: a function from an observation to an action."""

    act: Callable[[FloatArray], ArrayLike]

    def reset(self, seed: int, environment: str) -> None:
        """Does nothing: the function has no memory."""


def _takes_observation(found: Any) -> bool:
    """Returns whether an object is a function with exactly one required argument, the observation."""
    if isinstance(found, type) or not callable(found) or hasattr(found, "act"):
        return False
    try:
        signature = inspect.signature(found)
    except ValueError:  # compiled functions may have no signature
        return False
    return not _can_bind(signature, 0) and _can_bind(signature, 1)


def _can_bind(signature: inspect.Signature, count: int) -> bool:
    try:
        signature.bind(*range(count))
    except TypeError:
        return False
    return True


def _external(name: str, found: Any, plugin: UsedPlugin) -> ExternalController:
    """Returns the object ``found`` as an external controller. Creates one instance to report errors early."""
    if _takes_observation(found):
        found = _Function(found)
    ready_made = not isinstance(found, type) and hasattr(found, "act")

    def make() -> Controller:
        try:
            controller: Any = copy.deepcopy(found) if ready_made else found()
        except (Exception, SystemExit) as error:  # external code may raise anything
            raise PolicyError(
                f"{name}: cannot be created ({_error_text(error)}); correct the error in the controller"
            ) from error
        lacking = [each for each in ("reset", "act") if not callable(getattr(controller, each, None))]
        if lacking:
            raise PolicyError(
                f"{name}: {type(controller).__name__} has no method {' and '.join(lacking)}; "
                "a controller needs the methods reset(seed, environment) and act(observation)"
            )
        return controller

    first = make()
    close_controller(first)
    cameras, commands = getattr(first, "cameras", ()), bool(getattr(first, "takes_commands", False))
    return ExternalController(name, make, plugin, tuple(cameras), commands)


def to_controller_error(error: BaseException) -> ControllerError:
    """Returns a ``ControllerError`` of the kind ``exception`` with the text of ``error``."""
    return (
        error if isinstance(error, ControllerError) else ControllerError(f"exception: {_error_text(error)}")
    )


def _error_text(error: BaseException) -> str:
    """Returns an exception's type and message in one line of printable characters."""
    line = " ".join(f"{type(error).__name__}: {error}".split())
    return "".join(character if character.isprintable() else "?" for character in line)[:MAX_ERROR_CHARACTERS]
