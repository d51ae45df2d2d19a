"""How MuJoCo draws where there is no screen, which is to be settled before it is imported."""

import os
import sys
from ctypes.util import find_library

SCREENS = ("DISPLAY", "WAYLAND_DISPLAY")
LIBRARIES = {"EGL": "egl", "OSMesa": "osmesa"}
"""What can draw without a screen, and what MuJoCo calls it; the first that is installed is taken."""
HOW_TO_DRAW = (
    "set MUJOCO_GL=egl (graphics card or Mesa) or MUJOCO_GL=osmesa (software) in the environment "
    "before Python starts"
)


def choose_renderer() -> None:
    """Set ``MUJOCO_GL``, unless it is set, this is not Linux, or there is a screen."""
    if sys.platform != "linux" or "MUJOCO_GL" in os.environ or any(os.environ.get(name) for name in SCREENS):
        return
    name = next((name for library, name in LIBRARIES.items() if find_library(library)), None)
    if name is not None:
        os.environ["MUJOCO_GL"] = name
