"""What is known of the packaged tasks before any of them is imported."""

from itertools import product

TASKS = ("Feeding", "Drinking", "ScratchItch", "BedBathing")
ROBOTS = ("Jaco", "PR2")
"""By name, as their records have it."""
EPISODE_STEPS = 200
WORLD_VERSION = 2
"""Version of the simulated world: its physics, the starts of its episodes, and its rewards.

A release that changes the states that a recording's commands lead to has a higher one. Recordings store it.
"""


def environment_id(task: str, robot: str) -> str:
    """The id of a task's environment with a robot, both by name."""
    return f"avrgym/{task}{robot}-v1"


ENVIRONMENTS = tuple(environment_id(task, robot) for task, robot in product(TASKS, ROBOTS))
"""Their ids; other packages may add to them."""


def expected_errors(environment_id: str) -> tuple[type[Exception], ...]:
    """The errors for which a command over all environments leaves this one out and names it.

    Code of other packages may raise any exception.
    """
    return (ValueError, RuntimeError) if environment_id in ENVIRONMENTS else (Exception,)
