"""What a session runs: its trials in order, and how they are run."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Sex
from avrgym.policies.registry import AnyPolicy, find_for_session
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.questionnaires.stop_rules import StopRules
from avrgym.recording.configuration import RecordedConsent
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.texts.interface_texts import ENGLISH, Texts


@dataclass(frozen=True)
class TrialPlan:
    """One trial to run: an environment, a policy by name or path, a seed; a practice trial has no questionnaire.

    ``goal`` tells the participant in one sentence what the task is, the task's own unless given. ``items`` are asked
    after it, those of its session unless given. ``earlier_attempts`` were made at it in other sessions.
    """

    environment: str
    policy: str
    seed: int
    practice: bool
    goal: str = ""
    items: Sequence[Item] | None = None
    earlier_attempts: int = 0


@dataclass(frozen=True)
class OpenQuestionnaire:
    """The questionnaire of a trial that was completed in an earlier session, before every item was answered.

    ``trial`` and ``attempt`` are numbers from 1; ``given`` are the answers so far, by item.
    """

    trial: int
    attempt: int
    recording: Path
    given: Mapping[str, int]


@dataclass(frozen=True)
class HeadsetCheckPlan:
    """How long a headset is checked: at rest, with the arms being stretched, and while the participant moves.

    ``stop_s`` is how long the participant may take to try the stop.
    """

    at_rest_s: float = 10.0
    stretched_s: float = 10.0
    moving_s: float = 40.0
    stop_s: float = 60.0


@dataclass(frozen=True)
class SessionPlan:
    """A session: its trials in order, the body model, and who takes part.

    ``free_movement_s`` is how long the person moves freely before and after each trial, ``countdown_s`` the wait before
    the robot starts, ``trial_steps`` a trial's length in control steps of 0.1 s. ``first_trial`` counts from 1: a
    session that goes on after a break begins there. ``haptics`` and ``sounds`` say whether touches are felt and
    successes heard. ``furniture`` is what the participant really sits and lies on. ``force_guard``: arms that press too
    hard draw back, see ``safety.force_guard``. ``withdraw_after_success``: once a task that ends with success is
    complete the robot withdraws and waits, see ``safety.withdrawal``. ``stop_rules``: at which answers the session
    pauses or ends. ``texts``: what the participant reads, in their language, in which goals and items stand already.
    ``headset_check``: before all else the headset is checked so. ``measure_reach``: who is measured also stretches
    their arms, which become as long as theirs. ``open_questionnaire`` comes before all else.
    ``consent``: the participant's consent, for the recordings.
    """

    trials: Sequence[TrialPlan]
    sex: Sex
    free_movement_s: float
    simulated: bool
    items: Sequence[Item] = LIKERT_ITEMS
    trial_steps: int = EPISODE_STEPS
    countdown_s: float = 3.0
    first_trial: int = 1
    haptics: bool = True
    sounds: bool = True
    furniture: RealFurniture = field(default_factory=RealFurniture)
    force_guard: bool = True
    withdraw_after_success: bool = True
    stop_rules: StopRules = field(default_factory=StopRules)
    texts: Texts = ENGLISH
    headset_check: HeadsetCheckPlan | None = None
    measure_reach: bool = False
    open_questionnaire: OpenQuestionnaire | None = None
    consent: RecordedConsent | None = None

    def __post_init__(self) -> None:
        last = len(self.trials) + (self.open_questionnaire is not None)
        if not 1 <= self.first_trial <= last:
            raise ValueError(f"first_trial is {self.first_trial}; there are trials 1 to {len(self.trials)}")

    def goal_of(self, trial: TrialPlan) -> str:
        """What the participant is told that the task is."""
        return trial.goal or self.texts.translate(TASKS[find_environment(trial.environment)[0]].goal)

    def items_after(self, trial: TrialPlan) -> Sequence[Item]:
        """What is asked after a trial, in order."""
        if trial.practice:
            return ()
        return self.items if trial.items is None else trial.items


def practised_trials(environments: Sequence[str], policy: str, trials: int, seed: int) -> list[TrialPlan]:
    """For each environment a practice trial and then so many trials; each trial takes the next seed."""
    order = [(environment, i == 0) for environment in environments for i in range(trials + 1)]
    return [
        TrialPlan(environment, policy, seed + i, practice) for i, (environment, practice) in enumerate(order)
    ]


Policies = Mapping[tuple[str, str], AnyPolicy]
"""By environment and the policy's name or path: the same name means another policy in each environment."""


def load_policies(plan: SessionPlan) -> Policies:
    """Every policy that a plan names.

    Raises:
        ValueError: for an unknown environment or a policy that cannot be loaded.
    """
    return {
        (environment, policy): find_for_session(policy, environment)
        for environment, policy in {(trial.environment, trial.policy) for trial in plan.trials}
    }
