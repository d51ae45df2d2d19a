"""Experts with a low-pass filtered pose of the person. The tool therefore does not follow a tremor."""

from dataclasses import replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import Simulation, State
from avrgym.tasks.task import Controller, Expert, RunningEpisodes, TaskState

FILTERED_POSITION_FIELDS = ("head_pos_w", "mouth_pos_w", "person_capsule_ends_w", "right_arm_pos_w")
FILTERED_ROTATION_FIELDS = ("head_quat_w", "right_arm_quat_w")
"""Fields of the state with rotations of the person's body parts, which are filtered."""


def filter_tremor(expert: Expert) -> Expert:
    """Returns the expert with a filtered observation of the person.

    The observed pose of the person is the mean of the current and the previous control step. Tremor changes direction
    at every control step (``people.impairments``). The mean therefore removes the tremor.
    """

    def make(episodes: RunningEpisodes) -> Controller:
        return _FilteredExpert(_FilteredEpisodes(episodes), expert)

    return make


class _FilteredEpisodes:
    """Running episodes with a filtered state of the person."""

    def __init__(self, episodes: RunningEpisodes) -> None:
        self._episodes = episodes
        self._before = self._now = episodes.get_state()

    def look(self) -> None:
        """Store the current state for the filter. Call it once per control step."""
        self._before, self._now = self._now, self._episodes.get_state()

    @property
    def simulation(self) -> Simulation:
        return self._episodes.simulation

    @property
    def scene(self) -> SceneConfig:
        return self._episodes.scene

    @property
    def task_state(self) -> TaskState:
        return self._episodes.task_state

    def get_state(self) -> State:
        before, now = self._before, self._now
        places = {
            name: 0.5 * (getattr(before, name) + getattr(now, name)) for name in FILTERED_POSITION_FIELDS
        }
        rotations = {
            name: _between(getattr(before, name), getattr(now, name)) for name in FILTERED_ROTATION_FIELDS
        }
        return replace(now, **places, **rotations)


class _FilteredExpert:
    def __init__(self, seen: _FilteredEpisodes, expert: Expert) -> None:
        self._seen, self._controller = seen, expert(seen)

    def __call__(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) of the next control step."""
        self._seen.look()
        return self._controller(observation)


def _between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Returns the mean of two rotations (..., 4)."""
    same = np.sign((a * b).sum(axis=-1, keepdims=True))
    return transforms.normalize(a + same * b)
