"""AVR Gym: real people meet simulated assistive robots in virtual reality.

Importing the package registers the Gymnasium environments. On Linux without a screen it also has MuJoCo draw with a
library that needs none, by ``MUJOCO_GL``, unless that is set or MuJoCo was imported before. MuJoCo's warnings go to
the logger ``avrgym.mujoco``.
"""

from typing import TYPE_CHECKING, Any

from avrgym.system.headless import choose_renderer

choose_renderer()

from avrgym.envs.registration import register  # noqa: E402
from avrgym.system.mujoco_warnings import log_warnings  # noqa: E402

if TYPE_CHECKING:
    from avrgym.envs.parallel import AssistiveParallelEnv

register()
log_warnings()


def parallel_env(environment_id: str, **how: Any) -> "AssistiveParallelEnv":
    """Robot and human as two agents: PettingZoo's parallel environment; see ``AssistiveParallelEnv`` for arguments.

    Raises:
        RuntimeError: without PettingZoo, naming what brings it.
        ValueError: for an unknown name, naming what is allowed.
    """
    try:
        from avrgym.envs.parallel import AssistiveParallelEnv
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"{error.name} is missing; `pip install avrgym[pettingzoo]` brings what two agents need"
        ) from error
    return AssistiveParallelEnv(environment_id, **how)
