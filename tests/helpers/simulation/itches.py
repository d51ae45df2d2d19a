"""Itch positions."""

from dataclasses import replace

import numpy as np

from avrgym.tasks.episodes import Episodes
from avrgym.tasks.scratch_itch.reward import ScratchItchState


def around_axis(from_axis, angle, along):
    """Return positions in a limb's frame; angles are measured from its outer side."""
    return np.stack([-from_axis * np.cos(angle), from_axis * np.sin(angle), along], axis=-1)


def forearm_itch(episodes: Episodes, angle) -> ScratchItchState:
    """Return itches in the middle of the forearm at angles (N,) from its outer side."""
    limb, itch = np.ones(len(angle), dtype=np.intp), around_axis(0.033, angle, np.full(len(angle), -0.13))
    return replace(episodes.task_state, limb=limb, itch=itch)
