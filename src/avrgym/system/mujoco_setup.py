"""Configures MuJoCo's rendering backend and log. The backend must be chosen before MuJoCo is imported."""

import ctypes
import logging
import os
import sys
from ctypes.util import find_library

DISPLAY_VARIABLES = ("DISPLAY", "WAYLAND_DISPLAY")
OFFSCREEN_LIBRARIES = {"EGL": "egl", "OSMesa": "osmesa"}
"""Libraries for rendering without a screen, and their names in MuJoCo. The first installed library is used."""
PLATFORM_BACKENDS = {"linux": ("glx", "egl", "osmesa"), "win32": ("wgl",), "darwin": ("cgl",)}
COMMON_BACKENDS = ("glfw", "off")
OTHER_MUJOCO_GL_VALUES = ("", "enable", "enabled", "on", "true", "1", "disable", "disabled", "false", "0")
"""Values of the environment variable ``MUJOCO_GL`` that MuJoCo accepts, in addition to names of libraries."""
RENDERING_HINT = (
    "set MUJOCO_GL=egl (graphics card or Mesa) or MUJOCO_GL=osmesa (software) in the environment "
    "before Python starts"
)


def choose_rendering_backend() -> None:
    """Set ``MUJOCO_GL`` on Linux without a screen. An existing value is not changed."""
    if (
        sys.platform != "linux"
        or "MUJOCO_GL" in os.environ
        or any(os.environ.get(name) for name in DISPLAY_VARIABLES)
    ):
        return
    name = next((name for library, name in OFFSCREEN_LIBRARIES.items() if find_library(library)), None)
    if name is not None:
        os.environ["MUJOCO_GL"] = name


def check_rendering_backend() -> None:
    """Raises ``ValueError`` if MuJoCo cannot be imported with the value of ``MUJOCO_GL``."""
    asked = os.environ.get("MUJOCO_GL", "").lower().strip()
    allowed = (*PLATFORM_BACKENDS.get(sys.platform, ()), *COMMON_BACKENDS)
    if asked not in (*allowed, *OTHER_MUJOCO_GL_VALUES):
        raise ValueError(
            f"unknown value of the environment variable MUJOCO_GL={asked}; allowed: {', '.join(allowed)}; "
            "or unset MUJOCO_GL"
        )
    library = next((library for library, name in OFFSCREEN_LIBRARIES.items() if name == asked), None)
    if sys.platform == "linux" and library is not None and not _can_load(library):
        raise ValueError(
            f"the environment variable MUJOCO_GL={asked} needs the library {library}, which is not installed; "
            f"install {library}, or unset MUJOCO_GL to use an installed library"
        )


def _can_load(library: str) -> bool:
    """Returns whether a shared library can be loaded by one of the names that PyOpenGL tries."""
    for name in (f"lib{library}.so", *(f"lib{library}.so.{version}" for version in reversed(range(10)))):
        try:
            ctypes.CDLL(name)
        except OSError:
            continue
        return True
    return False


def log_mujoco_warnings() -> None:
    """Send MuJoCo's warnings to the logger ``avrgym.mujoco``. An existing warning handler of MuJoCo is not replaced.

    Without a handler, MuJoCo writes ``MUJOCO_LOG.TXT`` into the current folder.
    """
    import mujoco

    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logging.getLogger("avrgym.mujoco").warning)
