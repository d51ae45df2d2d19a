"""The environments in LeRobot's convention, as a plug-in for ``lerobot-train`` and ``lerobot-eval``.

The option ``--env.discover_packages_path=avrgym.envs.lerobot`` imports this package. It registers LeRobot's environment
type ``avrgym``, and a Gymnasium environment such as ``avrgym-lerobot/FeedingJaco-v1`` for each environment.
"""

# The types of LeRobot and of Gymnasium's functions are unknown or known only in part.
# pyright: basic, reportMissingImports=false

from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.envs.configs import EnvConfig
from lerobot.utils.constants import ACTION, OBS_ENV_STATE, OBS_IMAGES, OBS_STATE

from avrgym.envs.lerobot_environment import LeRobotEnv
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import ENVIRONMENTS

ENVIRONMENT_NAMESPACE = "avrgym-lerobot"

for _environment_id in ENVIRONMENTS:
    gym.register(
        f"{ENVIRONMENT_NAMESPACE}/{_environment_id.partition('/')[2]}",
        entry_point=LeRobotEnv,  # pyright: ignore[reportArgumentType]
        order_enforce=False,  # LeRobot reads the instruction from the outermost environment
        kwargs={"environment_id": _environment_id},
    )


@EnvConfig.register_subclass("avrgym")
@dataclass
class AvrGymEnvConfig(EnvConfig):
    """LeRobot's configuration of an environment: ``--env.type=avrgym``.

    ``task`` is an environment id without its prefix ``avrgym/``. ``cameras`` are descriptions such as ``wrist:128x96``;
    ``people``, ``impairment`` and ``force_guard`` are those of ``gym.make``.
    """

    task: str | None = "FeedingJaco-v1"
    fps: int = 10
    episode_length: int = EPISODE_STEPS
    people: str = "original"
    impairment: str = "none"
    force_guard: bool = False
    cameras: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        environment = LeRobotEnv(f"avrgym/{self.task}", **self.gym_kwargs)
        spaces: Any = environment.observation_space
        actions: Any = environment.action_space
        environment.close()
        self.features = {ACTION: PolicyFeature(FeatureType.ACTION, actions.shape)}
        self.features_map = {ACTION: ACTION}
        for name, kind, feature in (
            ("agent_pos", FeatureType.STATE, OBS_STATE),
            ("environment_state", FeatureType.ENV, OBS_ENV_STATE),
        ):
            if name in spaces.spaces:
                self.features[name] = PolicyFeature(kind, spaces[name].shape)
                self.features_map[name] = feature
        for name, space in spaces["pixels"].items() if "pixels" in spaces.spaces else ():
            self.features[f"pixels/{name}"] = PolicyFeature(FeatureType.VISUAL, space.shape)
            self.features_map[f"pixels/{name}"] = f"{OBS_IMAGES}.{name}"

    @property
    def package_name(self) -> str:
        """Name of the Python package that registers the environments."""
        return __name__

    @property
    def gym_id(self) -> str:
        """Environment id for ``gym.make``, such as ``avrgym-lerobot/FeedingJaco-v1``."""
        return f"{ENVIRONMENT_NAMESPACE}/{self.task}"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Keyword arguments for ``gym.make``: people, impairment, force guard, cameras and episode length."""
        return {
            "people": self.people,
            "impairment": self.impairment,
            "force_guard": self.force_guard,
            "cameras": self.cameras,
            "episode_steps": self.episode_length,
        }
