"""Physics of N worlds with MuJoCo. The logger ``avrgym.mujoco`` receives MuJoCo's warnings."""

from avrgym.system.mujoco_setup import log_mujoco_warnings

log_mujoco_warnings()
