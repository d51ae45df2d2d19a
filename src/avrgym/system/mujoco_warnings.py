"""Where MuJoCo's warnings go: to Python's logging, as of the logger ``avrgym.mujoco``, and into no file of its own."""

import logging

import mujoco


def log_warnings() -> None:
    """Hand MuJoCo's warnings to logging, unless somebody has taken them already.

    Without this MuJoCo writes ``MUJOCO_LOG.TXT`` into whatever folder it runs in.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(logging.getLogger("avrgym.mujoco").warning)
