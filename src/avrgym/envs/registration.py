"""Registers the Gymnasium environments, each as an environment of one world and as a vector environment.

The modules of the environments are imported when the first environment is created.
"""

# The types of Gymnasium's functions are known only in part.
# pyright: reportUnknownMemberType=false

from collections.abc import Iterable

import gymnasium as gym

from avrgym.system import plugins
from avrgym.tasks.constants import EPISODE_STEPS, PACKAGED_ENVIRONMENTS


def register_environments() -> None:
    """Register one Gymnasium environment for each pair of task and robot."""
    for environment_id in _environment_ids():
        gym.register(
            environment_id,
            entry_point="avrgym.envs.single:single_entry_point",
            vector_entry_point="avrgym.envs.vector:AssistiveVectorEnv",
            max_episode_steps=EPISODE_STEPS,
            kwargs={"environment_id": environment_id},
        )


def _environment_ids() -> Iterable[str]:
    """Returns the ids of all environments. If no plug-ins are installed, no task is imported."""
    if not (
        plugins.list_entry_points(plugins.TASK_ENTRY_POINT_GROUP)
        or plugins.list_entry_points(plugins.ROBOT_ENTRY_POINT_GROUP)
    ):
        return PACKAGED_ENVIRONMENTS
    from avrgym.tasks import registry

    return registry.ENVIRONMENTS
