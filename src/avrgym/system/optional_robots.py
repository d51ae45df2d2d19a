"""Packaged robots with meshes in another package. An extra of AVR Gym installs this package."""

from importlib.util import find_spec

MESH_PACKAGE_BY_ROBOT = {"Stretch": "stretch_urdf"}
"""Python package with the meshes of each robot, by name of the robot. The name of the extra is the robot's name in
lower case.
"""


def _is_installed(package: str) -> bool:
    try:
        return find_spec(package) is not None
    except ImportError:
        return False


INSTALL_COMMAND_BY_ROBOT = {
    robot: f"pip install avrgym[{robot.lower()}]"
    for robot, package in MESH_PACKAGE_BY_ROBOT.items()
    if not _is_installed(package)
}
"""Installation command of each robot that is not available because its package is missing."""
INSTALLED_ROBOTS = tuple(robot for robot in MESH_PACKAGE_BY_ROBOT if robot not in INSTALL_COMMAND_BY_ROBOT)


def format_install_hint(name: str) -> str:
    """Returns the last part of an error message for the unknown ``name``: how to install the robots that it contains.

    The text is empty if ``name`` contains no missing robot.
    """
    return "".join(
        f". `{command}` adds {robot}" for robot, command in INSTALL_COMMAND_BY_ROBOT.items() if robot in name
    )
