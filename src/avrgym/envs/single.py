"""The Gymnasium environment of one world, for ``gym.make``."""

from collections.abc import Mapping, Sequence
from inspect import currentframe
from types import FrameType
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.error import ResetNeeded

from avrgym.array_types import Float32Array
from avrgym.envs.rendering import Renderer
from avrgym.envs.specs import SerializableSpecMixin
from avrgym.envs.vector_conventions import NO_TIME_LIMIT, check_episode_length, to_python_seed
from avrgym.models.cameras import (
    STATE_ENTRY,
    AnyObservation,
    CameraDescription,
    CameraSpec,
    list_image_formats,
    parse_cameras,
)
from avrgym.models.human import Person, convert_to_person
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.tasks.actions import validate_actions
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.control_loop import StepOutcome
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import make_settings

ENVIRONMENT_METADATA: dict[str, Any] = {
    "render_modes": ["rgb_array"],
    "render_fps": round(1.0 / CONTROL_STEP_S),
}
"""Gymnasium's metadata (render modes and frame rate) of environments at the default control rate."""


def make_metadata(episodes: Episodes) -> dict[str, Any]:
    """Returns Gymnasium's metadata of an environment, with its control rate as ``render_fps``."""
    return {**ENVIRONMENT_METADATA, "render_fps": episodes.settings.control_hz}


def make_spaces(
    episodes: Episodes, cameras: Sequence[CameraSpec] = ()
) -> tuple[gym.Space[Any], gym.Space[Float32Array]]:
    """Returns the observation space and the action space of one world.

    Observations are (O,), or with cameras dictionaries of ``state`` (O,) and images. Actions are (``action_size``,).
    """
    bound = episodes.observation_spec.bound
    observation: gym.Space[Any] = gym.spaces.Box(-bound, bound, dtype=np.float64)
    if cameras:
        spaces: dict[str, gym.Space[Any]] = {STATE_ENTRY: observation}
        for name, (shape, dtype, largest) in list_image_formats(cameras).items():
            spaces[name] = gym.spaces.Box(0, largest, shape, dtype)
        observation = gym.spaces.Dict(spaces)
    return observation, gym.spaces.Box(-1.0, 1.0, (episodes.action_size,), np.float32)


class AssistiveEnv(  # pyright: ignore[reportIncompatibleVariableOverride]
    SerializableSpecMixin, Renderer, gym.Env[AnyObservation, Float32Array]
):
    """Gymnasium environment of one world.

    ``info`` contains ``success`` (whether the task has succeeded in this episode), ``reward_terms`` (unweighted) and
    ``force_on_person`` (newtons). With the force guard, ``info`` also contains ``guard_interventions``, the number of
    interventions in the episode. The force guard or the withdrawal after success may replace the action. Then
    ``executed_action`` (A,) is the action at the end of the step.
    """

    metadata = ENVIRONMENT_METADATA

    def __init__(
        self,
        environment_id: str,
        *,
        people: str = "original",
        person: Person | Mapping[str, Any] | None = None,
        impairment: str = "none",
        render_mode: str | None = None,
        max_episode_steps: int = EPISODE_STEPS,
        withdraw_after_success: bool = False,
        force_guard: bool = False,
        cameras: Sequence[CameraDescription] = (),
        **settings: Any,
    ) -> None:
        """Create one world. People, person, impairment, withdrawal and force guard are arguments of ``Episodes``.

        The other keyword arguments are fields of ``Settings``. ``person`` may be a mapping with the fields of
        ``Person``. Episodes with ``max_episode_steps`` −1 never end. With ``cameras`` (names or ``CameraSpec``),
        observations are dictionaries.

        Raises:
            ValueError: for an unknown name or a number out of range. The message contains the allowed values.
        """
        check_render_mode(render_mode, environment_id)
        check_episode_length(max_episode_steps)
        self.render_mode = render_mode
        self.max_episode_steps = max_episode_steps
        self.episodes = Episodes(
            environment_id,
            1,
            people=people,
            person=convert_to_person(person),
            impairment=impairment,
            num_threads=1,
            withdraw_after_success=withdraw_after_success,
            force_guard=force_guard,
            settings=make_settings(settings),
        )
        self.metadata = make_metadata(self.episodes)
        self._cameras = parse_cameras(cameras, self.episodes.scene.robot)
        self.observation_space, self.action_space = make_spaces(self.episodes, self._cameras)
        self._steps_left = 0

    def reset(
        self, *, seed: int | np.integer | None = None, options: dict[str, Any] | None = None
    ) -> tuple[AnyObservation, dict[str, Any]]:
        """Start an episode. Returns the first observation and info. Without a seed, the random stream continues."""
        super().reset(seed=to_python_seed(seed))
        self._steps_left = self.max_episode_steps
        self.episodes.reset(np.array([0]), [self.np_random])
        self.close_camera()
        start = self.episodes.evaluate_state()
        return self._observed(start), make_info(start)

    def step(self, action: Float32Array) -> tuple[AnyObservation, float, bool, bool, dict[str, Any]]:
        """Perform one control step. Returns observation, reward, terminated, truncated and info.

        The episode is truncated after ``max_episode_steps`` and never terminates. An error does not change the state.

        Raises:
            ValueError: for an action of another shape than (A,), or with numbers that are not finite.
            gymnasium.error.ResetNeeded: before the first reset, and after the end of an episode.
        """
        if not self._steps_left:
            raise ResetNeeded(
                f"no episode is running; call reset() to start an episode of {self.max_episode_steps} steps"
            )
        step = self.episodes.step(validate_actions(action, (self.episodes.action_size,))[None])
        self._steps_left -= 1
        return self._observed(step), float(step.reward[0]), False, self._steps_left == 0, make_info(step)

    def close(self) -> None:
        """Free the graphics memory of images. The next image allocates it again."""
        super().close()
        self.episodes.close_renderer()

    def _observed(self, step: StepOutcome) -> AnyObservation:
        if not self._cameras:
            return step.observation[0]
        images = self.episodes.render_images(self._cameras)
        return {STATE_ENTRY: step.observation[0], **{name: image[0] for name, image in images.items()}}


class _SingleEntry:
    """Entry point of ``gym.make``.

    If an environment renders images but lacks the render mode "human", Gymnasium implements this mode with a window.
    Without a screen the window fails at the first reset. With "human" in this metadata, Gymnasium adds no window, and
    the environment can reject the mode.
    """

    metadata: ClassVar[dict[str, Any]] = {
        **ENVIRONMENT_METADATA,
        "render_modes": [*ENVIRONMENT_METADATA["render_modes"], "human"],
    }

    def __call__(self, **kwargs: Any) -> AssistiveEnv:
        return AssistiveEnv(**kwargs, max_episode_steps=_requested_length(currentframe()))


def _requested_length(entry: FrameType | None) -> int:
    """Returns the argument ``max_episode_steps`` of the ``gym.make`` call that called the entry point.

    Gymnasium wraps the environment in a time limit and does not pass the limit to the environment. The environment
    needs the limit to reject steps after the end of an episode. A wrapper around the time limit
    (``additional_wrappers``) does not work, because ``gym.make_vec`` rejects it together with a vector entry point.
    """
    make = None if entry is None or entry.f_back is None else entry.f_back.f_locals
    asked, spec = (None if make is None else make.get(name) for name in ("max_episode_steps", "env_spec"))
    return asked or getattr(spec, "max_episode_steps", None) or NO_TIME_LIMIT


single_entry_point = _SingleEntry()


def make_info(step: StepOutcome) -> dict[str, Any]:
    """Returns Gymnasium's ``info`` dictionary for the first world.

    Values have Python's types. Gymnasium's vector environments convert Python's bools to arrays, but not NumPy's bools.
    """
    info: dict[str, Any] = {
        "success": bool(step.success[0]),
        "reward_terms": {name: float(term[0]) for name, term in step.reward_terms.items()},
        "force_on_person": float(step.force_on_person_n[0]),
    }
    if step.guard_interventions is not None:
        info["guard_interventions"] = int(step.guard_interventions[0])
    if step.overridden_mask is not None and step.overridden_mask[0]:
        info["executed_action"] = step.executed_action[0].copy()
    return info


def check_render_mode(render_mode: str | None, environment_id: str) -> None:
    """Raises ``ValueError`` for an unknown render mode. The message lists the allowed modes."""
    if render_mode is not None and render_mode not in ENVIRONMENT_METADATA["render_modes"]:
        raise ValueError(
            f"unknown render mode {render_mode!r}; allowed: None, {', '.join(ENVIRONMENT_METADATA['render_modes'])}; "
            f"`avrgym view {environment_id}` shows the environment live in a browser"
        )
