"""Packaged robots with meshes in another package, which an extra installs."""

from importlib.util import find_spec

PACKAGES = {"Stretch": "stretch_urdf"}
"""Package with the meshes of each robot. The name of the extra is the robot's name in lower case."""


def _is_installed(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except ImportError:
        return False


MISSING = {
    robot: f"pip install avrgym[{robot.lower()}]"
    for robot, package in PACKAGES.items()
    if not _is_installed(package)
}
"""Robots that are not available because the package is missing, and the command that installs it."""
INSTALLED = tuple(robot for robot in PACKAGES if robot not in MISSING)


def how_to_add(name: str) -> str:
    """Returns the end of an error message about the unknown ``name``: commands that install missing robots in this
    name."""
    return "".join(f". `{command}` adds {robot}" for robot, command in MISSING.items() if robot in name)
