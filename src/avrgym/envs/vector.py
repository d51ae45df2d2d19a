"""The native vector environment, for ``gym.make_vec``: it steps many worlds in parallel."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, Float32Array, FloatArray, NumpyArray
from avrgym.envs.rendering import Camera
from avrgym.envs.single import check_render_mode, make_metadata, make_spaces
from avrgym.envs.specs import SerializableSpecMixin
from avrgym.envs.vector_conventions import (
    SeedArgument,
    SubEnvironment,
    WorldRandomGenerators,
    check_episode_length,
    check_positive_integer,
    make_final_infos,
    make_vector_infos,
    merge_step_outcomes,
    read_reset_mask,
)
from avrgym.models.cameras import STATE_ENTRY, AnyObservation, CameraDescription, parse_cameras
from avrgym.models.human import Person, convert_to_person
from avrgym.system.engine_names import THREADS
from avrgym.system.type_guards import is_array
from avrgym.tasks.actions import validate_actions
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import make_settings


class AssistiveVectorEnv(  # pyright: ignore[reportIncompatibleVariableOverride]
    SerializableSpecMixin, VectorEnv[AnyObservation, Float32Array, NumpyArray]
):
    """N worlds that are stepped in parallel. Behaves like ``gymnasium.vector.SyncVectorEnv`` of N single environments.

    ``autoreset_mode`` determines when a world starts its next episode: in the last step of the old episode (default),
    in the next step, or only by ``reset`` with ``options={"reset_mask": mask}``. In the second mode, this next step
    ignores the world's action and returns reward 0.
    """

    single_observation_space: gym.Space[Any]
    single_action_space: gym.Space[Any]
    action_space: gym.Space[Any]

    def __init__(
        self,
        environment_id: str,
        num_envs: int = 1,
        *,
        people: str = "original",
        person: Person | Mapping[str, Any] | None = None,
        impairment: str = "none",
        render_mode: str | None = None,
        num_threads: int = 0,
        max_episode_steps: int = EPISODE_STEPS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        engine: str = THREADS,
        withdraw_after_success: bool = False,
        force_guard: bool = False,
        cameras: Sequence[CameraDescription] = (),
        **settings: Any,
    ) -> None:
        """Create N worlds.

        People, person, impairment, threads, engine, withdrawal and force guard are arguments of ``Episodes``.

        The other keyword arguments are fields of ``Settings``. ``person`` may be a mapping with the fields of
        ``Person``. Episodes with ``max_episode_steps`` −1 never end. With ``cameras`` (names or ``CameraSpec``),
        observations are dictionaries.

        Raises:
            ValueError: for an unknown name or a number out of range. The message contains the allowed values.
            RuntimeError: if a package that the engine needs is not installed.
        """
        self._views: dict[int, Camera] = {}
        check_render_mode(render_mode, environment_id)
        check_positive_integer("num_envs", num_envs)
        check_episode_length(max_episode_steps)
        self.autoreset_mode = _autoreset_mode(autoreset_mode)
        self.render_mode = render_mode
        self.num_envs = num_envs
        self.max_episode_steps = max_episode_steps
        self.episodes = Episodes(
            environment_id,
            num_envs,
            people=people,
            person=convert_to_person(person),
            impairment=impairment,
            num_threads=num_threads,
            engine=engine,
            withdraw_after_success=withdraw_after_success,
            force_guard=force_guard,
            settings=make_settings(settings),
        )
        self.metadata = {**make_metadata(self.episodes), "autoreset_mode": self.autoreset_mode}
        self._cameras = parse_cameras(cameras, self.episodes.scene.robot)
        if self._cameras and engine != THREADS:
            raise ValueError(
                f"engine {engine!r} does not support cameras, because images are rendered on the host; allowed engine: "
                f"{THREADS!r}"
            )
        self.single_observation_space, self.single_action_space = make_spaces(self.episodes, self._cameras)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._now: StepOutcome | None = None
        self._steps = np.zeros(num_envs, dtype=int)
        self._ended: BoolArray = np.zeros(num_envs, dtype=bool)
        self._random = WorldRandomGenerators(num_envs)
        self._worlds = [
            SubEnvironment(self, index, make_metadata(self.episodes)) for index in range(num_envs)
        ]

    def __getstate__(self) -> dict[str, Any]:
        """Returns the attributes for copying and pickling, without cameras. A copy continues bit-identically and
        creates its own cameras.
        """
        return {**self.__dict__, "_views": {}}

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The random generators of the worlds, as a tuple (N,)."""
        return tuple(self._random.generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The seeds of the worlds' random generators, as a tuple (N,)."""
        return tuple(self._random.seeds)

    def reset(
        self, *, seed: SeedArgument = None, options: dict[str, Any] | None = None
    ) -> tuple[AnyObservation, dict[str, Any]]:
        """Start episodes in all worlds, or in those of ``options["reset_mask"]``, boolean (N,).

        Returns observations of all worlds, and infos of the reset worlds. With seed s, world i has the same episode as
        the single environment with seed s + i. A list contains a seed for each world; None continues the world's random
        stream.

        Raises:
            ValueError: if the number of seeds is not N, or for an invalid mask.
            gymnasium.error.ResetNeeded: if the mask of the first reset does not include all worlds.
        """
        world_mask = read_reset_mask(options, self.num_envs)
        if self._now is None and not world_mask.all():
            raise ResetNeeded(
                "reset_mask of the first reset does not include all worlds; call reset() without reset_mask"
            )
        self._random.reseed(seed, world_mask)
        self._ended = self._ended & ~world_mask
        start = self._begin(world_mask)
        return self._observed(start), make_vector_infos(start, world_mask)

    def step(
        self, actions: Float32Array
    ) -> tuple[AnyObservation, FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Perform one control step in all worlds. Returns observations, rewards, terminations, truncations and infos.

        An error does not change the state.

        Raises:
            ValueError: for actions of another shape than (N, A), or with numbers that are not finite.
            gymnasium.error.ResetNeeded: before the first reset, and after the end of an episode without automatic
                reset.
        """
        self._check_running()
        same_step, ended = self.autoreset_mode is AutoresetMode.SAME_STEP, self._ended
        assert self.action_space.shape is not None
        step = self.episodes.step(validate_actions(actions, self.action_space.shape, ignored=ended))
        self._now = step
        self._steps += 1
        truncated = (self._steps == self.max_episode_steps) & ~ended
        final = self._final_infos(step, truncated) if same_step and truncated.any() else {}
        self._ended = np.zeros_like(truncated) if same_step else truncated
        now = self._begin(truncated if same_step else ended)
        told = make_vector_infos(now, np.ones(self.num_envs, dtype=bool))
        reward = np.where(ended, 0.0, step.reward)
        return self._observed(now), reward, np.zeros(self.num_envs, dtype=bool), truncated, told | final

    def _observed(self, step: StepOutcome) -> AnyObservation:
        """Returns the observations of all worlds. Images show the current state."""
        if not self._cameras:
            return step.observation.copy()
        return {STATE_ENTRY: step.observation.copy(), **self.episodes.render_images(self._cameras)}

    def _final_infos(self, step: StepOutcome, ended: BoolArray) -> dict[str, Any]:
        """Returns the last observations and infos of the worlds in the mask ``ended`` (N,)."""
        final = make_final_infos(step, ended)
        if self._cameras:
            worlds = np.nonzero(ended)[0].tolist()
            images = self.episodes.render_images(self._cameras, worlds)
            for row, world in enumerate(worlds):
                seen = {name: image[row] for name, image in images.items()}
                final["final_obs"][world] = {STATE_ENTRY: final["final_obs"][world], **seen}
        return final

    def _check_running(self) -> None:
        if self._now is None:
            raise ResetNeeded("no episode is running; call reset() first")
        if self.autoreset_mode is AutoresetMode.DISABLED and self._ended.any():
            raise ResetNeeded(
                f"the episodes of worlds {np.nonzero(self._ended)[0].tolist()} have ended; "
                'call reset(options={"reset_mask": mask}) to start new ones'
            )

    def _begin(self, world_mask: BoolArray) -> StepOutcome:
        """Start episodes in the worlds of a mask (N,). Returns the step results of all worlds."""
        ids = np.nonzero(world_mask)[0]
        if not len(ids) and self._now is not None:
            return self._now
        self._steps[ids] = 0
        for world in ids.tolist():
            if world in self._views:
                self._views.pop(world).close()
        self.episodes.reset(ids, [self._random.generators[world] for world in ids])
        start = self.episodes.evaluate_state()
        self._now = start if self._now is None else merge_step_outcomes(world_mask, start, self._now)
        return self._now

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Returns the attribute ``name`` of each world. If it is a method, calls it with the arguments and returns its
        result."""
        found = [getattr(world, name) for world in self._worlds]
        return tuple(each(*args, **kwargs) if callable(each) else each for each in found)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Returns the attribute ``name`` of each world, as a tuple (N,)."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of each world. ``values`` is a list or tuple (N,), or one value for all worlds.

        Raises:
            ValueError: if the number of values is not N.
        """
        each: Sequence[Any] = values if is_array(values) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise ValueError(
                f"{len(each)} values for {self.num_envs} worlds; allowed: one value for each world, or one for all"
            )
        for world, value in zip(self._worlds, each, strict=True):
            setattr(world, name, value)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Returns an image (480, 640, 3) of each world in the render mode ``rgb_array``, else ``None``.

        Use few worlds: each world needs its own model and graphics context.

        Raises:
            RuntimeError: if rendering fails. The message contains a setting that may help.
        """
        if self.render_mode is None:
            return None
        return tuple(self._picture(world) for world in range(self.num_envs))

    def _picture(self, world: int) -> NDArray[np.uint8]:
        if world not in self._views:
            self._views[world] = Camera(self.episodes, world)
        return self._views[world].render()

    def render_world(self, world: int) -> NDArray[np.uint8] | None:
        """Returns an image (480, 640, 3) of one world in the render mode ``rgb_array``, else ``None``."""
        return None if self.render_mode is None else self._picture(world)

    def close_extras(self, **kwargs: Any) -> None:
        """Free the graphics memory of the images of all worlds. Gymnasium's ``close`` calls this method."""
        for view in self._views.values():
            view.close()
        self._views.clear()
        self.episodes.close_renderer()


def _autoreset_mode(mode: AutoresetMode | str) -> AutoresetMode:
    try:
        return AutoresetMode(mode)
    except ValueError:
        allowed = ", ".join(f"{each} or {each.value!r}" for each in AutoresetMode)
        raise ValueError(f"unknown autoreset mode {mode!r}; allowed: {allowed}") from None
