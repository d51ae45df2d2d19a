"""The interface between the trainer and a recipe, which makes and learns from the episodes of an update."""

from dataclasses import dataclass
from typing import Any, Protocol

from avrgym.networks.policy import Policy, PolicyMetadata

CurvePoint = tuple[int, float, float]
"""Environment steps so far, and mean reward and success rate of the latest episodes."""


@dataclass(frozen=True)
class Update:
    """Results of an update: its stage, and mean reward and success rate of the policy's latest episodes.

    Both are None where the policy has had no episodes.
    """

    stage: str
    reward_mean: float | None
    success_rate: float | None


class Recipe(Protocol):
    """One way to train; ``training`` calls ``update`` until all steps are made, and saves the state after each."""

    @property
    def steps(self) -> int:
        """Environment steps so far."""
        ...

    @property
    def final_action_stds(self) -> tuple[float, ...]:
        """Candidates of the finished policy's action_std; the one with the highest success rate is kept."""
        ...

    def update(self) -> Update:
        """Run an episode in every world, and learn from it."""
        ...

    def policies(self, metadata: PolicyMetadata) -> list[Policy]:
        """The robot's policy as it is now, and the human's if one is trained."""
        ...

    def state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Everything that the next update depends on: tensors, and plain values."""
        ...

    def restore(self, tensors: dict[str, Any], values: dict[str, Any]) -> None:
        """Set everything to a state."""
        ...
