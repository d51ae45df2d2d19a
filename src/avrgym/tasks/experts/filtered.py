"""Experts who see people as they are on average, so that no tool follows a tremor to and fro."""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import Simulation, State
from avrgym.tasks.task import Controller, Expert, RunningEpisodes, TaskState

PLACES = ("head_pos_w", "mouth_pos_w", "person_segment_w", "right_arm_pos_w")
ROTATIONS = ("head_q_w", "right_arm_q_w")
"""What of a state is where the person is."""


def filtered(expert: Expert) -> Expert:
    """The same expert, who sees the person half-way between now and the control step before.

    Tremor changes its direction at every control step (``people.impairments``): between two of them it is gone.
    """

    def make(episodes: RunningEpisodes) -> Controller:
        return _FilteredExpert(_FilteredEpisodes(episodes), expert)

    return make


class _FilteredEpisodes:
    """Running episodes with people who are steadied."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        self._episodes = episodes
        self._before = self._now = episodes.state()

    def look(self) -> None:
        """See what there is now; at the beginning that is what there was."""
        self._before, self._now = self._now, self._episodes.state()

    @property
    def simulation(self) -> Simulation:
        return self._episodes.simulation

    @property
    def scene(self) -> SceneConfig:
        return self._episodes.scene

    @property
    def task_state(self) -> TaskState:
        return self._episodes.task_state

    def state(self) -> State:
        before, now = self._before, self._now
        places = {name: 0.5 * (getattr(before, name) + getattr(now, name)) for name in PLACES}
        rotations = {name: _between(getattr(before, name), getattr(now, name)) for name in ROTATIONS}
        return replace(now, **places, **rotations)


class _FilteredExpert:
    def __init__(self, seen: _FilteredEpisodes, expert: Expert) -> None:
        self._seen, self._controller = seen, expert(seen)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Actions (N, J)."""
        self._seen.look()
        return self._controller(observation)


def _between(a: FloatArray, b: FloatArray) -> FloatArray:
    """The rotations (..., 4) half-way between others."""
    same = np.sign((a * b).sum(axis=-1, keepdims=True))
    return transforms.normalize(a + same * b)
