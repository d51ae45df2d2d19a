"""AVR Gym: real people meet simulated assistive robots in virtual reality.

Importing the package registers the Gymnasium environments. On Linux without a screen the import also sets
``MUJOCO_GL`` to a rendering library that needs no screen. An existing value is not changed. The first
environment imports MuJoCo. MuJoCo's warnings go to the logger ``avrgym.mujoco``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from avrgym.system.mujoco_setup import choose_rendering_backend

choose_rendering_backend()

from avrgym.envs.registration import register  # noqa: E402

if TYPE_CHECKING:
    from avrgym.envs.parallel import AssistiveParallelEnv

register()


def parallel_env(environment_id: str, **arguments: Any) -> "AssistiveParallelEnv":
    """Create a PettingZoo parallel environment with two agents, robot and human; see ``AssistiveParallelEnv``.

    Raises:
        RuntimeError: without PettingZoo. The message contains the install command.
        ValueError: for an unknown name. The message lists the allowed names.
    """
    try:
        from avrgym.envs.parallel import AssistiveParallelEnv
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"{error.name} is missing; `pip install avrgym[pettingzoo]` installs it"
        ) from error
    return AssistiveParallelEnv(environment_id, **arguments)


def __getattr__(name: str) -> Any:
    """Import what describes people when it is first asked for, as in ``avrgym.models.human.Person``."""
    if name == "models":
        import_module("avrgym.models.human")
        return import_module("avrgym.models")
    raise AttributeError(f"module 'avrgym' has no attribute {name!r}")
