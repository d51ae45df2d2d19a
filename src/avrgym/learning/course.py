"""How a training stands: its latest episodes, its curve, and what goes into files before each update."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stable_baselines3 import PPO

from avrgym.learning import checkpoint
from avrgym.learning.configuration import TrainingConfiguration
from avrgym.learning.exporting import export_policy
from avrgym.learning.hard_episodes import HardEpisodes
from avrgym.learning.stable_baselines import Normaliser
from avrgym.policies.trained import Policy

POLICY_FILE, CHECKPOINT_FILE = "policy.safetensors", "checkpoint.pt"


@dataclass(frozen=True)
class Progress:
    """How a training stands: environment steps so far, and mean reward and success of the latest episodes."""

    steps: int
    reward_mean: float
    success_rate: float


Tell = Callable[[Progress], None]


class Course:
    """Gathers finished episodes, tells of them, and saves policy and checkpoint."""

    def __init__(self, configuration: TrainingConfiguration, out: Path, tell: Tell) -> None:
        self.configuration = configuration
        self.hard = HardEpisodes(configuration.worlds, configuration.hard_share, configuration.seed)
        self._out, self._tell = out, tell
        self._finished: list[tuple[float, bool]] = []
        self._curve: list[Progress] = []
        self._seconds_before, self._began = 0.0, time.monotonic()

    def resume(self, notes: dict[str, Any]) -> None:
        """Go on from the notes of a checkpoint."""
        self._finished = [(reward, success) for reward, success in notes["finished"]]
        self._curve = [Progress(*point) for point in notes["curve"]]
        self.hard.kept = notes.get("hard", [])  # checkpoints of earlier versions know of none
        self._seconds_before = notes["seconds"]

    def hear(self, steps: int, finished: list[tuple[float, bool]]) -> Progress:
        """Take return and success of episodes that ended after ``steps`` in all, and tell how training stands."""
        self._finished = (self._finished + finished)[-2 * self.configuration.worlds :]
        reward, success = (sum(column) / len(column) for column in zip(*self._finished, strict=True))
        now = Progress(steps, reward, success)
        self._curve.append(now)
        self._tell(now)
        return now

    @property
    def seconds(self) -> float:
        """How long it was trained for."""
        return self._seconds_before + time.monotonic() - self._began

    def policy(self, model: PPO, normaliser: Normaliser) -> Policy:
        """The policy as it is now."""
        curve = [(now.steps, now.reward_mean, now.success_rate) for now in self._curve]
        return export_policy(model, normaliser, self.configuration, self.seconds, curve)

    def save(self, model: PPO, normaliser: Normaliser, episodes: list[dict[str, Any]]) -> Policy:
        """Save where the training is, between two updates; the policy as it is now.

        ``episodes`` are the states that the present episodes were drawn from, where that follows from nothing else.
        """
        notes = {
            "finished": self._finished,
            "curve": [(now.steps, now.reward_mean, now.success_rate) for now in self._curve],
            "hard": self.hard.kept,
            "seconds": self.seconds,
        }
        checkpoint.save(self._out / CHECKPOINT_FILE, model, normaliser, episodes, notes)
        policy = self.policy(model, normaliser)
        policy.save(self._out / POLICY_FILE, overwrite=True)
        return policy
