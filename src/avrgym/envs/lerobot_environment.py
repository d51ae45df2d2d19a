"""An environment of one world with the observations and attributes that LeRobot expects."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from avrgym.array_types import Float32Array, NumpyArray
from avrgym.envs.single import AssistiveEnv
from avrgym.models.cameras import STATE_ENTRY, AnyObservation, CameraDescription
from avrgym.policies.lerobot import ENVIRONMENT_STATE_FEATURE, STATE_FEATURE, split_state_features
from avrgym.system.type_guards import is_table
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import make_policy_instruction

OBSERVATION_KEYS_BY_FEATURE = {STATE_FEATURE: "agent_pos", ENVIRONMENT_STATE_FEATURE: "environment_state"}
"""Maps each LeRobot feature of an observation to its key in the observation dictionary."""
LeRobotObservation = dict[str, Any]


class LeRobotEnv(gym.Env[LeRobotObservation, Float32Array]):
    """Environment of one world in LeRobot's convention.

    Observations are dictionaries in single precision, see ``split_state_features``. ``agent_pos`` contains the values
    that the robot measures itself. ``environment_state`` contains the other values. With cameras, ``pixels`` contains
    colour images such as ``wrist_rgb``. ``info`` also contains ``is_success``.
    """

    metadata = AssistiveEnv.metadata

    def __init__(
        self,
        environment_id: str,
        *,
        cameras: Sequence[CameraDescription] = (),
        render_mode: str | None = "rgb_array",
        episode_steps: int = EPISODE_STEPS,
        **arguments: Any,
    ) -> None:
        """Create one world. The other keyword arguments, and the errors, are those of ``AssistiveEnv``."""
        self._world = AssistiveEnv(
            environment_id,
            cameras=cameras,
            render_mode=render_mode,
            max_episode_steps=episode_steps,
            **arguments,
        )
        self.observation_description = self._world.episodes.observation_spec
        self.metadata, self.render_mode = self._world.metadata, render_mode
        self.task = self.task_description = make_policy_instruction(
            environment_id, self._world.episodes.settings
        )
        self._max_episode_steps = episode_steps
        self.action_space = self._world.action_space
        example = self._converted(self._world.observation_space.sample())
        self.observation_space = _space_like(example)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[LeRobotObservation, dict[str, Any]]:
        """Start an episode. Returns the first observation and Gymnasium's ``info`` dictionary."""
        super().reset(seed=seed)
        observation, info = self._world.reset(seed=seed)
        return self._converted(observation), {**info, "is_success": info["success"]}

    def step(self, action: Float32Array) -> tuple[LeRobotObservation, float, bool, bool, dict[str, Any]]:
        """Perform one control step. Returns observation, reward, terminated, truncated and info."""
        observation, reward, terminated, truncated, info = self._world.step(action)
        return (
            self._converted(observation),
            reward,
            terminated,
            truncated,
            {**info, "is_success": info["success"]},
        )

    def render(self) -> NumpyArray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Returns an RGB image (H, W, 3) of the scene, uint8."""
        return self._world.render()

    def close(self) -> None:
        """Close the renderer of the camera images, which frees its graphics memory."""
        self._world.close()

    def _converted(self, observation: AnyObservation) -> LeRobotObservation:
        entries = observation if isinstance(observation, dict) else {STATE_ENTRY: observation}
        states = split_state_features(self.observation_description, entries[STATE_ENTRY].astype(np.float32))
        found: LeRobotObservation = {OBSERVATION_KEYS_BY_FEATURE[name]: part for name, part in states.items()}
        pixels = {name: image for name, image in entries.items() if image.dtype == np.uint8}
        return {**found, "pixels": pixels} if pixels else found


def _space_like(example: LeRobotObservation) -> gym.spaces.Dict:
    """Returns an observation space with the keys, shapes and data types of an example observation."""
    spaces: dict[str, gym.Space[Any]] = {}
    for name, value in example.items():
        if is_table(value):
            spaces[name] = _space_like(value)
        elif value.dtype == np.uint8:
            spaces[name] = gym.spaces.Box(0, 255, value.shape, np.uint8)
        else:
            spaces[name] = gym.spaces.Box(-np.inf, np.inf, value.shape, np.float32)
    return gym.spaces.Dict(spaces)
