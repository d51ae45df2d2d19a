"""AVR Gym: simulated assistive robots help real people in virtual reality.

Importing the package registers the Gymnasium environments. On Linux without a screen, the import also sets
``MUJOCO_GL`` to a rendering library that needs no screen. An existing value is not changed. MuJoCo is imported when the
first environment is created. MuJoCo's warnings go to the logger ``avrgym.mujoco``.

In all docstrings, "the paper" is Erickson, Gu and Kemp, "Assistive VR Gym: Interactions with Real People to Improve
Virtual Assistive Robots", RO-MAN 2020.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from avrgym.system.mujoco_setup import choose_rendering_backend

choose_rendering_backend()

from avrgym.envs.registration import register_environments  # noqa: E402

if TYPE_CHECKING:
    from avrgym.envs.parallel import AssistiveParallelEnv

register_environments()


def parallel_env(environment_id: str, **arguments: Any) -> "AssistiveParallelEnv":
    """Returns a PettingZoo parallel environment with two agents, robot and human; see ``AssistiveParallelEnv``.

    Raises:
        RuntimeError: if PettingZoo is not installed. The message contains the install command.
        ValueError: for an unknown environment id. The message lists the allowed ids.
    """
    try:
        from avrgym.envs.parallel import AssistiveParallelEnv
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"the package {error.name} is not installed; run `pip install avrgym[pettingzoo]`"
        ) from error
    return AssistiveParallelEnv(environment_id, **arguments)


def __getattr__(name: str) -> Any:
    """Returns ``avrgym.models``, which is imported at its first use, as in ``avrgym.models.human.Person``."""
    if name == "models":
        import_module("avrgym.models.human")
        return import_module("avrgym.models")
    raise AttributeError(f"module 'avrgym' has no attribute {name!r}; allowed: models, parallel_env")
