"""The Gymnasium environments, registered: one world, or many as the native vector environment.

Whatever makes them is imported when the first one is made.
"""

# Gymnasium's functions: their types are known only in part.
# pyright: reportUnknownMemberType=false

import gymnasium as gym

from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.task import EPISODE_STEPS


def register() -> None:
    """Register every task with every robot."""
    for environment_id in ENVIRONMENTS:
        gym.register(
            environment_id,
            entry_point="avrgym.envs.single:single_entry",
            vector_entry_point="avrgym.envs.vector:AssistiveVectorEnv",
            max_episode_steps=EPISODE_STEPS,
            kwargs={"environment_id": environment_id},
        )
