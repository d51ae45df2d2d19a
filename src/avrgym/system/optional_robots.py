"""Packaged robots whose meshes are in a package that an extra installs."""

from importlib.util import find_spec

PACKAGES = {"Stretch": "stretch_urdf"}
"""Package with the meshes, by robot. The extra has the robot's name in lower case."""


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
"""Robots that are left out, and the command that adds them."""
INSTALLED = tuple(robot for robot in PACKAGES if robot not in MISSING)


def how_to_add(name: str) -> str:
    """The end of a message about an unknown robot or environment: the command that adds a robot that is left out."""
    return "".join(f". `{command}` adds {robot}" for robot, command in MISSING.items() if robot in name)
