"""The questions with which participants change their preferences for the robot."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import msgspec

from avrgym.commands.preferences import (
    DEFAULT_FORCE_LIMIT_FRACTION,
    Preferences,
    TrialRules,
    find_contradiction,
)
from avrgym.questionnaires.questionnaire import Item


@dataclass(frozen=True)
class PreferenceQuestion:
    """A question about one preference. ``answer_values``: the value of each answer, in the order of the labels."""

    preference_name: str
    text: str
    answer_values: tuple[Any, ...]
    answer_labels: tuple[str, ...]

    @property
    def questionnaire_item(self) -> Item:
        """The question as a questionnaire item with a labelled scale."""
        return Item(
            self.preference_name,
            self.text,
            len(self.answer_values),
            self.answer_labels[0],
            self.answer_labels[-1],
            self.answer_labels,
        )

    def find_answer(self, preferences: Preferences) -> int:
        """Returns the number of the answer (from 1) that is closest to a participant's preferences."""
        value = getattr(preferences, self.preference_name)
        if isinstance(value, str):
            return self.answer_values.index(value) + 1
        return (
            min(range(len(self.answer_values)), key=lambda index: abs(self.answer_values[index] - value)) + 1
        )

    def remove_contradictions(self, rules: Sequence[TrialRules]) -> "PreferenceQuestion":
        """Returns the question without the answers that contradict the rules of a trial."""
        pairs = [
            (value, label)
            for value, label in zip(self.answer_values, self.answer_labels, strict=True)
            if not any(
                find_contradiction(replace_preferences(each, {self.preference_name: value})) for each in rules
            )
        ]
        return PreferenceQuestion(
            self.preference_name, self.text, *(tuple(column) for column in zip(*pairs, strict=True))
        )


PREFERENCE_QUESTIONS = (
    PreferenceQuestion(
        "speed",
        "How fast should the robot move, compared with its usual speed?",
        (0.25, 0.5, 0.75, 1.0, 1.25),
        ("25 %", "50 %", "75 %", "100 %", "125 %"),
    ),
    PreferenceQuestion(
        "distance_m",
        "How far away from you should the robot wait?",
        (0.05, 0.1, 0.15, 0.2, 0.3, 0.4),
        ("5 cm", "10 cm", "15 cm", "20 cm", "30 cm", "40 cm"),
    ),
    PreferenceQuestion(
        "side",
        "On which side of you should the robot wait?",
        ("left", "any", "right"),
        ("on my left", "on any side", "on my right"),
    ),
    PreferenceQuestion(
        "bite_timing",
        "When should the robot continue?",
        ("on_cue", "after_swallowing", "with_company"),
        ("when I signal that I am ready", "by itself after a pause", "by itself when I face it"),
    ),
    PreferenceQuestion(
        "pause_s",
        "How long should the robot pause before it continues by itself?",
        (2.0, 4.0, 8.0, 15.0, 30.0),
        ("2 s", "4 s", "8 s", "15 s", "30 s"),
    ),
    PreferenceQuestion(
        "force_share",
        "At which force on you should the robot pull back, compared with the usual limit?",
        (0.1, 0.2, 0.3, 0.4, DEFAULT_FORCE_LIMIT_FRACTION),
        ("20 %", "40 %", "60 %", "80 %", "100 %"),
    ),
)
"""The questions in order. The German sentences are in ``texts/de.toml``."""


def find_possible_questions(rules: Sequence[TrialRules], *, force_guard: bool) -> list[PreferenceQuestion]:
    """Returns the questions with more than one possible answer that have an effect.

    Args:
        rules: the rules of all trials that use the participant's preferences.
        force_guard: whether the force guard is on in these trials.
    """
    without_effect = set[str]()
    if not any(each.preferences.continues_without_command for each in rules):
        without_effect.add("pause_s")
    if not force_guard:
        without_effect.add("force_share")
    questions = [
        question.remove_contradictions(rules)
        for question in PREFERENCE_QUESTIONS
        if question.preference_name not in without_effect
    ]
    return [question for question in questions if len(question.answer_values) > 1]


def replace_preferences(rules: TrialRules, changes: dict[str, Any]) -> TrialRules:
    """Returns the rules of a trial with changed preferences."""
    return msgspec.structs.replace(rules, preferences=msgspec.structs.replace(rules.preferences, **changes))
