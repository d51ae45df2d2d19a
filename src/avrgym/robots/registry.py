"""All robots by name: ours, and those that other packages register as entry points of ``avrgym.robots``."""

from collections.abc import Mapping

from avrgym.models.robot import Robot
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.pr2.robot import PR2
from avrgym.robots.validation import check_robot
from avrgym.system import plugins

_robots: dict[str, Robot] = {robot.name: robot for robot in (JACO, PR2)}
ROBOTS: Mapping[str, Robot] = _robots


def register(robot: Robot) -> None:
    """Add a robot.

    Raises:
        ValueError: for a name that is taken, or a record that ``check_robot`` refuses; nothing is added then.
    """
    if robot.name in _robots:
        raise ValueError(f"there is a robot {robot.name} already")
    check_robot(robot)
    _robots[robot.name] = robot


BROKEN = plugins.load(plugins.ROBOTS, Robot, register)
"""The robots of other packages that were skipped."""


def find_robot(name: str) -> Robot:
    """The robot of that name.

    Raises:
        ValueError: naming the robots there are.
    """
    if name not in ROBOTS:
        raise ValueError(f"unknown robot {name!r}; the robots are {', '.join(ROBOTS)}")
    return ROBOTS[name]
