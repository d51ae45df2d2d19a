"""The Gymnasium environments: one world, or many as the native vector environment."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from avrgym.episodes import EPISODE_STEPS, Episodes, Step
from avrgym.models.human import Person
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.rendering import Camera
from avrgym.tasks import ENVIRONMENTS
from avrgym.tasks.base import Task

Array = NDArray[np.float64]

ACTIONS = 7
METADATA = {"render_modes": ["rgb_array"], "render_fps": round(1.0 / CONTROL_STEP_S)}


def _spaces(task: Task) -> tuple[gym.Space[Array], gym.Space[NDArray[np.float32]]]:
    bound = task.observation_bound
    observation = gym.spaces.Box(-bound, bound, dtype=np.float64)
    return observation, gym.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)


class AssistiveEnv(gym.Env[Array, NDArray[np.float32]]):
    """One world. ``info``: ``success`` (so far), ``reward_terms`` (unweighted), ``force_on_person`` (N)."""

    metadata = METADATA

    def __init__(
        self,
        environment_id: str,
        *,
        people: str = "original",
        person: Person | None = None,
        impairment: str = "none",
        render_mode: str | None = None,
    ) -> None:
        """See ``Episodes`` for people, person and impairment.

        Raises:
            ValueError: for an unknown name, naming what is allowed.
        """
        _check_render_mode(render_mode)
        self.render_mode = render_mode
        self.episodes = Episodes(
            environment_id, 1, distribution=people, person=person, impairment=impairment, num_threads=1
        )
        self.observation_space, self.action_space = _spaces(self.episodes.task)
        self._steps = 0
        self._camera: Camera | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin an episode; without a seed the random stream goes on."""
        super().reset(seed=seed)
        self._steps = 0
        observation = self.episodes.begin(np.array([0]), [self.np_random])
        self.close()
        return observation[0], {"success": False, "reward_terms": {}, "force_on_person": 0.0}

    def step(self, action: NDArray[np.float32]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One control step of 0.1 s; the episode is truncated after 200 and never ends before."""
        step = self.episodes.step(np.asarray(action, float)[None])
        self._steps += 1
        info = {
            "success": bool(step.success[0]),
            "reward_terms": {name: float(term[0]) for name, term in step.reward_terms.items()},
            "force_on_person": float(step.force_on_person_n[0]),
        }
        return step.observation[0], float(step.reward[0]), False, self._steps >= EPISODE_STEPS, info

    def render(self) -> NDArray[np.uint8] | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """A picture (480, 640, 3) with the render mode ``rgb_array``, else nothing.

        Raises:
            RuntimeError: where no picture can be drawn, naming what to set.
        """
        if self.render_mode is None:
            return None
        if self._camera is None:
            self._camera = Camera(self.episodes, 0)
        return self._camera.picture()

    def close(self) -> None:
        """Put the camera away; the next picture takes a new one."""
        if self._camera is not None:
            self._camera.close()
            self._camera = None


class AssistiveVectorEnv(VectorEnv[Array, NDArray[np.float32], Array]):
    """N worlds stepped together; a finished world begins its next episode within the same step."""

    metadata = METADATA | {"autoreset_mode": AutoresetMode.SAME_STEP}

    def __init__(
        self,
        environment_id: str,
        num_envs: int = 1,
        *,
        people: str = "original",
        person: Person | None = None,
        impairment: str = "none",
        render_mode: str | None = None,
        num_threads: int = 0,
    ) -> None:
        """See ``Episodes`` for people, person, impairment and threads.

        Raises:
            ValueError: for an unknown name, naming what is allowed.
        """
        _check_render_mode(render_mode)
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.episodes = Episodes(
            environment_id,
            num_envs,
            distribution=people,
            person=person,
            impairment=impairment,
            num_threads=num_threads,
        )
        self.single_observation_space, self.single_action_space = _spaces(self.episodes.task)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._steps = np.zeros(num_envs, dtype=int)
        self._cameras: dict[int, Camera] = {}
        self._generators = _generators(None, num_envs)
        self.drawn_from = [_state(generator) for generator in self._generators]
        """States of the random streams that the present episodes were drawn from, one a world."""

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin episodes in all worlds. World i with seed s is the single environment with seed s + i."""
        if seed is not None:
            self._generators = _generators(seed, self.num_envs)
        return self._begin(np.arange(self.num_envs)), {}

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One control step of all worlds."""
        step = self.episodes.step(np.asarray(actions, float))
        self._steps += 1
        truncated = self._steps >= EPISODE_STEPS
        info = _vector_info(step)
        observation = step.observation
        if truncated.any():
            observation, info = self._begin_again(truncated, step, info)
        return observation, step.reward, np.zeros(self.num_envs, dtype=bool), truncated, info

    def _begin_again(
        self, done: NDArray[np.bool_], step: Step, info: dict[str, Any]
    ) -> tuple[Array, dict[str, Any]]:
        ids = np.nonzero(done)[0]
        observation = step.observation.copy()
        observation[ids] = self._begin(ids)
        final = {"final_obs": step.observation, "_final_obs": done, "final_info": info, "_final_info": done}
        return observation, info | final

    def _begin(self, ids: NDArray[np.intp]) -> Array:
        self._steps[ids] = 0
        for world in ids:
            self.drawn_from[world] = _state(self._generators[world])
        for world in self._cameras.keys() & set(ids.tolist()):
            self._cameras.pop(world).close()
        return self.episodes.begin(ids, [self._generators[i] for i in ids])

    def begin_again_from(self, drawn_from: list[dict[str, Any]]) -> Array:
        """Begin the episodes in all worlds that were drawn from these states; give their observations."""
        for generator, state in zip(self._generators, drawn_from, strict=True):
            generator.bit_generator.state = state
        return self._begin(np.arange(self.num_envs))

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture (480, 640, 3) of each world with the render mode ``rgb_array``, else nothing.

        Every world has a model and a graphics context of its own: meant for a few worlds.

        Raises:
            RuntimeError: where no picture can be drawn, naming what to set.
        """
        if self.render_mode is None:
            return None
        for world in range(self.num_envs):
            if world not in self._cameras:
                self._cameras[world] = Camera(self.episodes, world)
        return tuple(self._cameras[world].picture() for world in range(self.num_envs))

    def close_extras(self, **kwargs: Any) -> None:
        """Put the cameras away."""
        for camera in self._cameras.values():
            camera.close()
        self._cameras.clear()


def _vector_info(step: Step) -> dict[str, Any]:
    every = np.ones(len(step.reward), dtype=bool)
    terms = dict(step.reward_terms) | {f"_{name}": every for name in step.reward_terms}
    return {
        "success": step.success, "_success": every,
        "reward_terms": terms, "_reward_terms": every,
        "force_on_person": step.force_on_person_n, "_force_on_person": every,
    }  # fmt: skip


def _generators(seed: int | list[int | None] | None, count: int) -> list[np.random.Generator]:
    seeds = (
        [None] * count
        if seed is None
        else [seed + i for i in range(count)]
        if isinstance(seed, int)
        else seed
    )
    return [seeding.np_random(s)[0] for s in seeds]


def _state(generator: np.random.Generator) -> dict[str, Any]:
    return dict(generator.bit_generator.state)


def _check_render_mode(render_mode: str | None) -> None:
    if render_mode is not None and render_mode not in METADATA["render_modes"]:
        raise ValueError(
            f"unknown render mode {render_mode!r}; the modes are None, {', '.join(METADATA['render_modes'])}"
        )


def register() -> None:
    """Register every task with every robot."""
    for environment_id in ENVIRONMENTS:
        gym.register(
            environment_id,
            entry_point="avrgym.envs:AssistiveEnv",
            vector_entry_point="avrgym.envs:AssistiveVectorEnv",
            kwargs={"environment_id": environment_id},
        )
