"""Names and constants of the packaged tasks and robots, for modules that must not import the tasks."""

from itertools import product

from avrgym.system import optional_robots

PAPER_TASKS = ("Feeding", "Drinking", "ScratchItch", "BedBathing")
PACKAGED_TASKS = (*PAPER_TASKS, "Dressing", "ArmManipulation")
PACKAGED_ROBOTS = ("Jaco", "PR2", "Panda", "Gen3", "UR5", *optional_robots.INSTALLED_ROBOTS)
"""Names of the packaged robots, including optional robots with installed meshes."""
EPISODE_STEPS = 200
SIMULATION_VERSION = 2
"""Version of the simulation: physics, initial states and rewards. Recordings store this version.

With another version, the recorded actions may lead to different states.
"""


def make_environment_id(task: str, robot: str) -> str:
    """Returns the environment id of a task with a robot, such as ``avrgym/FeedingJaco-v1``."""
    return f"avrgym/{task}{robot}-v1"


PACKAGED_ENVIRONMENTS = tuple(
    make_environment_id(task, robot) for task, robot in product(PACKAGED_TASKS, PACKAGED_ROBOTS)
)
"""Ids of the packaged environments. Plug-ins register further ids."""
PAPER_ENVIRONMENTS = tuple(
    make_environment_id(task, robot) for task, robot in product(PAPER_TASKS, ("Jaco", "PR2"))
)
"""Ids of the environments in the paper (Erickson, Gu and Kemp, 2020). These environments have packaged policies."""


def list_skippable_errors(environment_id: str) -> tuple[type[Exception], ...]:
    """Returns the exceptions for which a command skips this environment and continues with the next one.

    Plug-ins may raise any exception.
    """
    return (ValueError, RuntimeError) if environment_id in PACKAGED_ENVIRONMENTS else (Exception,)
