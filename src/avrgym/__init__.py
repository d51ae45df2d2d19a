"""AVR Gym: real people meet simulated assistive robots in virtual reality.

Importing the package registers the Gymnasium environments. On Linux without a screen it also has MuJoCo draw with a
library that needs none, by ``MUJOCO_GL``, unless that is set or MuJoCo was imported before. MuJoCo's warnings go to
the logger ``avrgym.mujoco``.
"""

from avrgym.system.headless import choose_renderer

choose_renderer()

from avrgym.envs.registration import register  # noqa: E402
from avrgym.system.mujoco_warnings import log_warnings  # noqa: E402

register()
log_warnings()
