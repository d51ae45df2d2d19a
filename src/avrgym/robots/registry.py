"""Registry of robots: packaged robots, and plug-ins of the entry point group ``avrgym.robots``."""

from collections.abc import Mapping

from avrgym.models.robot import Robot
from avrgym.robots.gen3.robot import GEN3
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.panda.robot import PANDA
from avrgym.robots.pr2.robot import PR2
from avrgym.robots.stretch.robot import STRETCH
from avrgym.robots.ur5.robot import UR5
from avrgym.robots.validation import check_robot
from avrgym.system import plugins
from avrgym.system.optional_robots import INSTALL_COMMAND_BY_ROBOT, format_install_hint

_PACKAGED = (JACO, PR2, PANDA, GEN3, UR5, STRETCH)
_robots: dict[str, Robot] = {
    robot.name: robot for robot in _PACKAGED if robot.name not in INSTALL_COMMAND_BY_ROBOT
}
ROBOTS: Mapping[str, Robot] = _robots
"""Registered robots by name: packaged robots and plug-ins."""


def register_robot(robot: Robot) -> None:
    """Add a robot to the registry.

    Raises:
        ValueError: if the name is already registered, or the record is invalid. The registry does not change.
    """
    if robot.name in _robots:
        raise ValueError(f"a robot with the name {robot.name} is already registered; choose another name")
    check_robot(robot)
    _robots[robot.name] = robot


SKIPPED_PLUGINS = plugins.load_plugins(plugins.ROBOT_ENTRY_POINT_GROUP, Robot, register_robot)
"""Plug-ins of robots that were skipped, with their error messages."""


def find_robot(name: str) -> Robot:
    """Returns the robot with this name.

    Raises:
        ValueError: for an unknown name. The message lists the robots.
    """
    if name not in ROBOTS:
        raise ValueError(f"unknown robot {name!r}; allowed: {', '.join(ROBOTS)}{format_install_hint(name)}")
    return ROBOTS[name]
