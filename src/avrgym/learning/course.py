"""How a training stands: its latest episodes, its curve, and what goes into files before each update."""

# Stable-Baselines3's attributes: their types are known only in part.
# pyright: reportUnknownMemberType=false

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from avrgym.learning import checkpoint
from avrgym.learning.configuration import TrainingConfiguration, stored_people
from avrgym.learning.exporting import export_policy
from avrgym.learning.hard_episodes import HardEpisodes
from avrgym.learning.stable_baselines import Normaliser, Trainee
from avrgym.networks.policy import HumanRole, Policy
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.populations import HUMAN_FILE
from avrgym.system.files import read_user_text

POLICY_FILE, CHECKPOINT_FILE = "policy.safetensors", "checkpoint.pt"


@dataclass(frozen=True)
class Progress:
    """How a training stands: its stage in words, environment steps so far, and how the latest episodes went.

    Mean reward and success are those of the policy's own episodes; None before there are any.
    """

    stage: str
    steps: int
    reward_mean: float | None
    success_rate: float | None


CurvePoint = tuple[int, float, float]
"""Environment steps so far, and mean reward and success of the latest episodes."""
Tell = Callable[[Progress], None]


class Course:
    """Gathers finished episodes, tells of them, and saves policy and checkpoint."""

    def __init__(self, configuration: TrainingConfiguration, out: Path, tell: Tell) -> None:
        self.configuration = configuration
        self.hard = HardEpisodes(configuration.worlds, configuration.hard_share, configuration.seed)
        self._out, self._tell = out, tell
        self._finished: list[tuple[float, bool]] = []
        self._curve: list[CurvePoint] = []
        self._seconds_before, self._began = 0.0, time.monotonic()

    def resume(self, notes: dict[str, Any]) -> None:
        """Go on from the notes of a checkpoint."""
        self._finished = [(reward, success) for reward, success in notes["finished"]]
        self._curve = [(steps, reward, success) for steps, reward, success in notes["curve"]]
        self.hard.kept = notes.get("hard", [])  # checkpoints of earlier versions know of none
        self._seconds_before = notes["seconds"]

    @property
    def latest(self) -> CurvePoint:
        """The latest point of the curve."""
        return self._curve[-1]

    def imitated(self, steps: int, finished: list[tuple[float, bool]]) -> None:
        """Take what the policy did in a round of imitation, after ``steps`` in all, and tell how training stands."""
        each, all_steps = self.configuration.update_steps, self.configuration.imitation_steps
        self.hear(f"imitation, round {steps // each} of {all_steps // each}", steps, finished)

    def hear(self, stage: str, steps: int, finished: list[tuple[float, bool]]) -> None:
        """Take return and success of episodes that have ended in a stage, and tell how training stands."""
        self._finished = (self._finished + finished)[-2 * self.configuration.worlds :]
        if finished:
            reward, success = (sum(column) / len(column) for column in zip(*self._finished, strict=True))
            self._curve.append((steps, reward, success))
        self.tell(stage, steps)

    def tell(self, stage: str, steps: int) -> None:
        """Tell how training stands in a stage."""
        reward, success = self._curve[-1][1:] if self._curve else (None, None)
        self._tell(Progress(stage, steps, reward, success))

    @property
    def seconds(self) -> float:
        """How long it was trained for."""
        return self._seconds_before + time.monotonic() - self._began

    def policies(self, trainees: Sequence[Trainee[Normaliser]]) -> list[Policy]:
        """The policies as they are now: the robot's, and the human's where one is trained."""
        robot, *humans = trainees
        policy = self._policy(robot)
        return [policy, *(self._policy(human, self._role(policy)) for human in humans)]

    def _policy(self, trainee: Trainee[Normaliser], role: HumanRole | None = None) -> Policy:
        return export_policy(*trainee, self.configuration, self.seconds, self._curve, role)

    def _role(self, partner: Policy) -> HumanRole:
        people = stored_people(self.configuration, self._out)
        text = "" if people in NAMED_DISTRIBUTIONS else read_user_text(Path(people))
        return HumanRole(partner=partner.digest, people_file=text)

    def save(self, trainees: Sequence[Trainee[Normaliser]], episodes: list[dict[str, Any]]) -> list[Policy]:
        """Save where the training is, between two updates; the policies as they are now.

        ``episodes`` are the states that the present episodes were drawn from, where that follows from nothing else.
        """
        notes = {
            "finished": self._finished,
            "curve": self._curve,
            "hard": self.hard.kept,
            "seconds": self.seconds,
        }
        checkpoint.save(self._out / CHECKPOINT_FILE, trainees, episodes, notes)
        policies = self.policies(trainees)
        for policy, name in zip(policies, (POLICY_FILE, HUMAN_FILE), strict=False):
            policy.save(self._out / name, overwrite=True)
        return policies
