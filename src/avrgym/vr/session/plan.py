"""The plan of a session: its trials in order, and its settings."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from avrgym.commands.preferences import TrialRules
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.models.human import Sex
from avrgym.policies.registry import AnyPolicy, find_default_policy_name, resolve_session_policy
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.questionnaires.stop_rules import StopRuleSet
from avrgym.recording.configuration import RecordedConsent
from avrgym.recording.input_profile import DEFAULT_INPUT_PROFILE, InputProfile
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.registry import find_environment, get_goal_description
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings
from avrgym.texts.interface_texts import ENGLISH_TEXTS, InterfaceTexts
from avrgym.vr.session.headset_time import NO_SESSION_RULES, SessionRules


@dataclass(frozen=True)
class TrialPlan:
    """One trial: environment, policy (name or path) and seed; a practice trial has no questionnaire.

    ``goal_description`` describes the task to the participant in one sentence; default: the task's goal.
    ``questionnaire_items`` is the questionnaire; default: the session's questionnaire. ``num_earlier_attempts`` is
    the number of attempts in other sessions. ``rules`` are the participant's commands and preferences in this trial.
    ``allow_preference_changes``: whether the participant may change these preferences. ``settings``: settings of the
    trial's scene; default: the settings of the session.
    """

    environment: str
    policy: str
    seed: int
    practice: bool
    goal_description: str = ""
    questionnaire_items: Sequence[Item] | None = None
    num_earlier_attempts: int = 0
    rules: TrialRules | None = None
    allow_preference_changes: bool = False
    settings: Settings | None = None


@dataclass(frozen=True)
class OpenQuestionnaire:
    """A questionnaire with unanswered items, about a trial of an earlier session.

    ``trial_number`` and ``attempt_number``: numbers of the trial and of the attempt, from 1. ``recording``: the file of
    the attempt. ``existing_answers``: the existing answers, by the item's identifier.
    """

    trial_number: int
    attempt_number: int
    recording: Path
    existing_answers: Mapping[str, int]


@dataclass(frozen=True)
class HeadsetCheckPlan:
    """Durations of the headset check's measurements: at rest, with stretched arms, and in motion.

    ``test_stop_limit_s`` is the time limit for the test stop.
    """

    rest_duration_s: float = 10.0
    stretch_duration_s: float = 10.0
    motion_duration_s: float = 40.0
    test_stop_limit_s: float = 60.0


@dataclass(frozen=True)
class SessionPlan:
    """The plan of a session.

    ``free_movement_s``: duration of free movement before and after each trial. ``countdown_s``: waiting time before the
    robot starts. ``trial_steps``: a trial's length in control steps. ``first_trial_number``: number (from 1) of the
    first trial in this session; above 1 if earlier sessions completed trials. ``haptics``, ``sounds``: whether
    touches and successes give this feedback. ``furniture`` is the real seat or bed. ``has_force_guard``: see
    ``safety.has_force_guard``. ``withdraw_tool_after_success``: see ``safety.withdrawal``. ``stop_rules``: answers
    that pause or end the session. ``texts``: the participant's texts in their language, with goals and items.
    ``headset_check``: durations of the headset check; ``None`` without a check. ``reach_measurement_enabled``:
    whether to measure the participant's arm length for the body model. ``open_questionnaire``: a questionnaire of an
    earlier session that is completed first. ``consent``: the participant's consent, for the recordings.
    ``proxy_consent``: the consent of a representative. ``respondent``: the person who answers questions,
    ``participant`` or ``proxy``. ``is_simulated``: whether the participant is simulated. ``questionnaire_items``: the
    questionnaire after each trial. ``input_profile``: input and stop methods of the participant at the start of the
    session. ``settings``: settings of all environments.
    ``allow_other_settings``: whether policies may have been trained with other settings. ``session_rules``: breaks
    and the limit of the time in VR. ``break_items``: the questions after a break.
    """

    trials: Sequence[TrialPlan]
    sex: Sex
    free_movement_s: float
    is_simulated: bool
    questionnaire_items: Sequence[Item] = LIKERT_ITEMS
    trial_steps: int = EPISODE_STEPS
    countdown_s: float = 3.0
    first_trial_number: int = 1
    haptics: bool = True
    sounds: bool = True
    furniture: RealFurniture = field(default_factory=RealFurniture)
    has_force_guard: bool = True
    withdraw_tool_after_success: bool = True
    stop_rules: StopRuleSet = field(default_factory=StopRuleSet)
    texts: InterfaceTexts = ENGLISH_TEXTS
    headset_check: HeadsetCheckPlan | None = None
    reach_measurement_enabled: bool = False
    open_questionnaire: OpenQuestionnaire | None = None
    consent: RecordedConsent | None = None
    proxy_consent: RecordedConsent | None = None
    respondent: str = "participant"
    input_profile: InputProfile = DEFAULT_INPUT_PROFILE
    settings: Settings = DEFAULT_SETTINGS
    allow_other_settings: bool = False
    session_rules: SessionRules = NO_SESSION_RULES
    break_items: Sequence[Item] = ()

    def __post_init__(self) -> None:
        last = len(self.trials) + (self.open_questionnaire is not None)
        if not 1 <= self.first_trial_number <= last:
            raise ValueError(f"first_trial is {self.first_trial_number}; allowed: 1 to {len(self.trials)}")

    def find_goal_text(self, trial: TrialPlan) -> str:
        """Returns the description of the task for the participant."""
        task, _ = find_environment(trial.environment)
        return trial.goal_description or self.texts.translate(
            get_goal_description(task, self.find_trial_settings(trial))
        )

    def find_trial_settings(self, trial: TrialPlan) -> Settings:
        """Returns the settings of a trial's scene."""
        return self.settings if trial.settings is None else trial.settings

    def find_questionnaire_items(self, trial: TrialPlan) -> Sequence[Item]:
        """Returns the questionnaire items that follow a trial, in order."""
        if trial.practice:
            return ()
        return self.questionnaire_items if trial.questionnaire_items is None else trial.questionnaire_items


def plan_trials_with_practice(
    environments: Sequence[str], policy: str | None, trials: int, seed: int
) -> list[TrialPlan]:
    """Returns a practice trial and ``trials`` trials for each environment.

    Seeds increase by 1 from trial to trial. Without ``policy``, each environment has its default policy.
    """
    order = [(environment, i == 0) for environment in environments for i in range(trials + 1)]
    return [
        TrialPlan(environment, policy or find_default_policy_name(environment), seed + i, practice)
        for i, (environment, practice) in enumerate(order)
    ]


SessionPolicies = Mapping[tuple[str, str], AnyPolicy]
"""Policies by (environment, name or path). A name refers to a different policy in each environment."""


def load_policies(plan: SessionPlan) -> SessionPolicies:
    """Load and return all policies of a plan.

    Raises:
        ValueError: for an unknown environment, or if a policy cannot be loaded.
    """
    return {
        (environment, policy): resolve_session_policy(
            policy, environment, settings, allow_other_settings=plan.allow_other_settings
        )
        for environment, policy, settings in {
            (trial.environment, trial.policy, plan.find_trial_settings(trial)) for trial in plan.trials
        }
    }
