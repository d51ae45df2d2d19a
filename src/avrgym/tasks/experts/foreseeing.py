"""Experts who see people where they are about to be, and nobody tremble.

Whoever moves is elsewhere by the time that a tool arrives. These experts know what people want to do, and see them as
they will be ``AHEAD_STEPS`` later; who imitates them learns to expect that, as far as earlier movements tell.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.models.human import GEOMS, RIGHT_ARM, People, body_frames
from avrgym.models.scene import SceneConfig
from avrgym.simulation.worlds import Simulation, State
from avrgym.tasks.task import Controller, Expert, RunningEpisodes, TaskState

Array = NDArray[np.float64]

AHEAD_STEPS = 1
"""How many control steps ahead people are seen, 0.1 s."""
PLACES = ("head_pos_w", "mouth_pos_w", "person_segment_w", "right_arm_pos_w")
ROTATIONS = ("head_q_w", "right_arm_q_w")
"""What of a state is where the person is."""


class EpisodesAhead(RunningEpisodes, Protocol):
    """Running episodes that tell how people will be."""

    def people_ahead(self, steps: int) -> tuple[People, People]:
        """How people want to be now, and so many control steps later."""
        ...


def foreseeing(expert: Expert) -> Callable[[EpisodesAhead], Controller]:
    """The same expert, who sees the person as they will be.

    They are moved as what they want moves, from half-way between now and the control step before: tremor changes its
    direction at every control step (``people.impairments``), and between two of them it is gone.
    """

    def make(episodes: EpisodesAhead) -> Controller:
        return _Foreseeing(_Seen(episodes), expert)

    return make


class _Seen:
    """Running episodes with people who are ahead of themselves."""

    def __init__(self, episodes: EpisodesAhead) -> None:
        self._episodes = episodes
        self._before = episodes.state()
        self._person = self._look()

    def look(self) -> None:
        """See what there is now; at the beginning that is what there was."""
        self._person = self._look()

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
        return replace(self._episodes.state(), **self._person)

    def _look(self) -> dict[str, Array]:
        """Where the person is seen."""
        before, now = self._before, self._episodes.state()
        self._before = now
        places = {name: 0.5 * (getattr(before, name) + getattr(now, name)) for name in PLACES}
        rotations = {name: _between(getattr(before, name), getattr(now, name)) for name in ROTATIONS}
        return _moved(places | rotations, _motions(self._episodes))


class _Foreseeing:
    def __init__(self, seen: _Seen, expert: Expert) -> None:
        self._seen, self._controller = seen, expert(seen)

    def __call__(self, observation: Array) -> Array:
        """Actions (N, J)."""
        self._seen.look()
        return self._controller(observation)


class _Motion(NamedTuple):
    """How a body moves: turned by (N, 4) about where it was, (N, 3), to where it comes, (N, 3), world frame."""

    turn: Array
    from_w: Array
    to_w: Array

    def point(self, pos_w: Array) -> Array:
        """Where points (N, 3) of the body come."""
        return self.to_w + transforms.rotate(self.turn, pos_w - self.from_w)


def _motions(episodes: EpisodesAhead) -> dict[str, _Motion]:
    """How each body of the person is about to move."""
    posture = episodes.scene.posture
    (from_w, before), (to_w, after) = (
        body_frames(people, posture) for people in episodes.people_ahead(AHEAD_STEPS)
    )
    return {
        body: _Motion(
            transforms.multiply(after[body], transforms.conjugate(before[body])), from_w[body], to_w[body]
        )
        for body in from_w
    }


def _moved(person: Mapping[str, Array], motions: Mapping[str, _Motion]) -> dict[str, Array]:
    """Where a person is whose bodies have moved, ``PLACES`` and ``ROTATIONS``."""
    head, arm = motions["head"], [motions[body] for body in RIGHT_ARM]
    segments = [motions[geom.body] for geom in GEOMS.values()]
    pos_w, q_w = person["right_arm_pos_w"], person["right_arm_q_w"]
    ends_w = person["person_segment_w"]
    return {
        "head_pos_w": head.point(person["head_pos_w"]),
        "mouth_pos_w": head.point(person["mouth_pos_w"]),
        "head_q_w": transforms.multiply(head.turn, person["head_q_w"]),
        "right_arm_pos_w": np.stack([each.point(pos_w[:, i]) for i, each in enumerate(arm)], axis=1),
        "right_arm_q_w": np.stack(
            [transforms.multiply(each.turn, q_w[:, i]) for i, each in enumerate(arm)], axis=1
        ),
        "person_segment_w": np.stack(
            [
                np.stack([each.point(ends_w[:, i, end]) for end in (0, 1)], axis=1)
                for i, each in enumerate(segments)
            ],
            axis=1,
        ),
    }


def _between(a: Array, b: Array) -> Array:
    """The rotations (..., 4) half-way between others."""
    same = np.sign((a * b).sum(axis=-1, keepdims=True))
    return transforms.normalize(a + same * b)
