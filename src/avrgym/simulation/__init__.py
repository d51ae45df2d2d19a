"""Physics of N worlds with MuJoCo; its warnings go to the logger ``avrgym.mujoco``."""

from avrgym.system.mujoco_setup import log_mujoco_warnings

log_mujoco_warnings()
