"""The interface of recipes (training methods). A recipe runs the episodes of an update and learns from them."""

from dataclasses import dataclass
from typing import Any, Protocol

from avrgym.networks.policy import Policy, PolicyMetadata

LearningCurvePoint = tuple[int, float, float]
"""A point of the learning curve: environment steps, mean reward and success rate of the latest episodes."""


@dataclass(frozen=True)
class UpdateResults:
    """Results of an update: the training stage, and mean reward and success rate of the policy's latest episodes.

    ``stage`` is ``imitation`` or ``PPO``. Mean reward and success rate are ``None`` before the policy completes its
    first episode.
    """

    stage: str
    reward_mean: float | None
    success_rate: float | None


class Recipe(Protocol):
    """A training method. The module ``training`` calls ``update`` until all steps are completed. It saves the state
    after each update."""

    @property
    def num_timesteps(self) -> int:
        """Returns the number of completed environment steps."""
        ...

    @property
    def candidate_action_stds(self) -> tuple[float, ...]:
        """Returns candidates for the action standard deviation of the trained policy. The one with the highest success
        rate is selected.
        """
        ...

    def update(self) -> UpdateResults:
        """Run an episode in every world, and learn from all episodes. Returns the results of this update."""
        ...

    def export_policies(self, metadata: PolicyMetadata) -> list[Policy]:
        """Returns the current policy of the robot, and that of the human if a human is trained."""
        ...

    def checkpoint_state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Returns the state for a checkpoint: a dictionary of tensors, and a dictionary of plain values."""
        ...

    def restore(self, tensors: dict[str, Any], values: dict[str, Any]) -> None:
        """Restore the recipe from the dictionaries that ``checkpoint_state`` returned."""
        ...
