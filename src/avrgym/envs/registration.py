"""The Gymnasium environments, registered: one world, or many as the native vector environment."""

# Gymnasium's functions: their types are known only in part.
# pyright: reportUnknownMemberType=false

from typing import Any, ClassVar

import gymnasium as gym

from avrgym.envs.single import METADATA, AssistiveEnv
from avrgym.envs.vector import AssistiveVectorEnv
from avrgym.tasks.episodes import EPISODE_STEPS
from avrgym.tasks.registry import ENVIRONMENTS

__all__ = ["AssistiveEnv", "AssistiveVectorEnv", "register", "single_entry"]


class _SingleEntry:
    """Makes the single environments that Gymnasium is asked for.

    Where an environment draws pictures, Gymnasium makes a window of the render mode "human", which fails at the first
    reset without a screen. With "human" among the modes here it hands the mode on, and the environment refuses it.
    """

    metadata: ClassVar[dict[str, Any]] = {**METADATA, "render_modes": [*METADATA["render_modes"], "human"]}

    def __call__(self, **kwargs: Any) -> AssistiveEnv:
        return AssistiveEnv(**kwargs)


single_entry = _SingleEntry()


def register() -> None:
    """Register every task with every robot."""
    for environment_id in ENVIRONMENTS:
        gym.register(
            environment_id,
            entry_point="avrgym.envs.registration:single_entry",
            vector_entry_point="avrgym.envs.registration:AssistiveVectorEnv",
            max_episode_steps=EPISODE_STEPS,
            kwargs={"environment_id": environment_id},
        )
