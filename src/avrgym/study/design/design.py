"""The design of a study: the validated contents of ``study.toml``."""

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import msgspec

from avrgym.commands.preferences import (
    ConditionRules,
    GestureThresholds,
    Preferences,
    apply_preferences,
)
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.questionnaires.questionnaire import Item, Questionnaire, list_items_at_moment
from avrgym.questionnaires.stop_rules import StopRule, StopRuleSet
from avrgym.robots.registry import ROBOTS
from avrgym.study.design.instruments import add_instrument_items
from avrgym.study.design.languages import check_translations
from avrgym.study.design.questionnaires import check_questionnaires, check_stop_rules
from avrgym.study.design.retention import RetentionPeriods, check_retention
from avrgym.study.design.toml_validation import DesignError as DesignError
from avrgym.study.design.toml_validation import (
    StructByKeyPath,
    ValidationError,
    check_id,
    check_known_name,
    check_name_pattern,
    check_unique_names,
    parse_toml,
    read_text,
)
from avrgym.system import random_streams
from avrgym.system.toml_lines import ValuePath
from avrgym.tasks.constants import make_environment_id
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, find_task_and_scene, get_goal_description
from avrgym.tasks.settings import DEFAULT_SETTINGS, PERSON_SETTINGS, Settings, make_settings
from avrgym.vr.lab_streaming.stream_settings import StreamSettings, find_stream_error
from avrgym.vr.session.headset_time import NO_SESSION_RULES, SessionRules

DESIGN_FILE = "study.toml"
FIELDS_FIXED_AFTER_ALLOCATION = (
    "seed", "tasks", "robots", "policies", "practice_policy", "trial_steps", "settings", "conditions"
)  # fmt: skip
"""Fields that must not change after the first participant was allocated to an order."""
SITE_SPECIFIC_FIELDS = ("site", "database", "recordings", "retention")
"""Fields that may differ between the sites of a study."""

InstructionText = Annotated[str, msgspec.Meta(min_length=1, max_length=160)]
NonEmptyNames = Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=8)]
OBJECT_STORE_URL_PATTERN = re.compile(r"s3://[a-z0-9][a-z0-9.-]{2,62}(/[A-Za-z0-9._-]+)*/?")
_POLICY = re.compile(r"(?!.*\.\.)[A-Za-z0-9_-][A-Za-z0-9_./:-]{0,79}")


class ConsentConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The consent text and its version. A changed text needs a new version."""

    version: Annotated[str, msgspec.Meta(min_length=1)]
    text: Annotated[str, msgspec.Meta(min_length=1)]


class InclusionQuestion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A yes-no question. Participants with another answer than ``required`` are excluded."""

    id: str
    text: Annotated[str, msgspec.Meta(min_length=1)]
    required: bool


class DatabaseConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The study's database. If ``url`` is empty, the database is the file ``study.db`` in the study's folder."""

    url: str = ""


class RecordingsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The object store with copies of the study's recordings, ``s3://BUCKET/FOLDER``. If ``url`` is empty, recordings
    are only in the study's folder.
    """

    url: str = ""


class Condition(ConditionRules, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A condition: a policy, the rules for commands of the participant, and settings of its scenes.

    ``settings`` replace the design's settings; default: the design's settings apply.
    """

    settings: Settings = DEFAULT_SETTINGS


class PublicationDetails(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Facts for publications that recordings do not contain. An unknown fact is an empty text."""

    ethics_approval: str = ""
    recruitment: str = ""
    compensation: str = ""
    gender: str = ""
    experience: str = ""
    location: str = ""
    headset: str = ""
    data_availability: str = ""


class Design(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The design of a whole study.

    ``site``: the name of the site, in a study with several sites. ``languages``: tags such as ``de``; the first is
    the language of the design. ``trial_steps``: control steps of a trial. ``practice_policy``: empty if there are no
    practice trials.
    ``goals``: instructions to participants by task; default: the task's own instruction. ``furniture``: the real seat
    and bed.
    ``max_held_share``: a trial is excluded from the analysis if the share of time with tracking loss is larger.
    ``force_guard``: the arms' contact forces and approach speed are limited; default: off.
    ``max_repeats``: maximum number of repeats of a trial by the experimenter; default: no limit.
    ``withdraw_after_success``: the robot withdraws its tool after success; default: it continues to the trial's end.
    ``streams``: data streams to and from other devices. ``sessions``: breaks and limits of sessions.
    ``headset_check``: sessions of people begin with a check of the headset.
    ``ask_functioning``: participants answer questions about disability, diagnosis and assistive devices.
    ``measure_reach``: arm lengths of people are measured and used for their simulated bodies.
    ``conditions``: conditions by name; ``policies`` may contain these names. A condition is a policy with commands of
    the participant.
    ``settings``: settings of all environments; a condition may have others. ``allow_other_settings``: also use
    policies trained with others.
    """

    title: Annotated[str, msgspec.Meta(min_length=1)]
    participants: Annotated[int, msgspec.Meta(ge=1)]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    tasks: NonEmptyNames
    robots: NonEmptyNames
    policies: NonEmptyNames
    practice_policy: str
    trial_steps: Annotated[int, msgspec.Meta(ge=1)]
    free_movement_s: Annotated[float, msgspec.Meta(ge=0, le=600)]
    blind_experimenter: bool
    site: str = ""
    languages: NonEmptyNames = ("en",)
    max_held_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 1.0
    max_repeats: Annotated[int, msgspec.Meta(ge=0)] | None = None
    force_guard: bool = False
    withdraw_after_success: bool = False
    headset_check: bool = False
    measure_reach: bool = False
    ask_functioning: bool = False
    allow_other_settings: bool = False
    consent: ConsentConfig
    inclusion: tuple[InclusionQuestion, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()
    stop_rules: tuple[StopRule, ...] = ()
    goals: Mapping[str, InstructionText] = {}
    furniture: RealFurniture = RealFurniture()
    settings: Settings = DEFAULT_SETTINGS
    sessions: SessionRules = NO_SESSION_RULES
    conditions: Mapping[str, Condition] = {}
    streams: StreamSettings = StreamSettings()
    reporting: PublicationDetails = PublicationDetails()
    retention: RetentionPeriods = RetentionPeriods()
    database: DatabaseConfig = DatabaseConfig()
    recordings: RecordingsConfig = RecordingsConfig()

    @property
    def robot_policy_pairs(self) -> tuple[tuple[str, str], ...]:
        """All pairs of robot and policy. The second name may be a condition."""
        return tuple(product(self.robots, self.policies))

    def find_condition_policy(self, name: str) -> str:
        """Returns the policy of the condition ``name``. If ``name`` is a policy, returns ``name``."""
        return self.conditions[name].policy if name in self.conditions else name

    def find_condition_settings(self, name: str) -> Settings:
        """Returns the scene settings of the condition ``name``; the design's settings for a policy."""
        if name not in self.conditions:
            return self.settings
        return make_settings(self.settings.changed_values | self.conditions[name].settings.changed_values)

    def find_task_instruction(self, task: str, name: str = "") -> str:
        """Returns the instruction to participants in a task; ``name`` is the condition or policy."""
        return self.goals.get(task) or get_goal_description(task, self.find_condition_settings(name))

    @property
    def items_by_id(self) -> dict[str, Item]:
        """All items of all questionnaires, by id."""
        return {item.id: item for questionnaire in self.questionnaires for item in questionnaire.items}

    @property
    def stop_rule_set(self) -> StopRuleSet:
        """The stop rules. They pause or end a session after certain answers."""
        return StopRuleSet(self.stop_rules, self.questionnaires)

    def find_item_questionnaire(self, item: str) -> Questionnaire | None:
        """Returns the questionnaire with this item; ``None`` if the design has no such item."""
        return next((each for each in self.questionnaires for own in each.items if own.id == item), None)

    def list_items_at_moment(self, when: str, seed: int = 0) -> tuple[Item, ...]:
        """Returns the items that are shown at the moment ``when``, in order. ``seed``: the trial's seed, for random
        orders.
        """
        return list_items_at_moment(self.questionnaires, when, seed)

    def list_fixed_field_values(self) -> dict[str, Any]:
        """Returns the fields that determine orders and trials, as JSON values. Default settings are omitted."""
        plain = msgspec.json.decode(msgspec.json.encode(self))
        return {name: plain[name] for name in FIELDS_FIXED_AFTER_ALLOCATION if plain[name] != {}}

    def make_blinded_policy_letters(self) -> dict[str, str]:
        """Returns a random letter for each policy. A blinded experimenter sees the letter instead of the name."""
        order = random_streams.make_policy_code_rng(self.seed, len(self.policies)).permutation(
            len(self.policies)
        )
        return {policy: chr(ord("A") + place) for policy, place in zip(self.policies, order, strict=True)}

    def choose_displayed_policy(self, policy: str, practice: bool) -> str:
        """Returns the policy of a trial as the experimenter sees it: its name, or if blinded, a letter or
        ``practice``.
        """
        if not self.blind_experimenter:
            return policy
        return "practice" if practice else self.make_blinded_policy_letters()[policy]


def read_default_design_text() -> str:
    """Returns the text of the default ``study.toml``: the paper's protocol, with comments."""
    return (files("avrgym") / "assets" / DESIGN_FILE).read_text(encoding="utf-8")


def read_design(path: Path) -> Design:
    """Returns the design in a file.

    Raises:
        DesignError: if the file is invalid.
        OSError: if the file cannot be read.
    """
    return parse_design(read_text(path), str(path), path.parent)


def parse_design(text: str, file_name: str = DESIGN_FILE, folder: Path = Path()) -> Design:
    """Returns the design in a TOML text; ``file_name``: the file's name in error messages.

    ``folder``: the study's folder with translations and texts of validated questionnaires.

    Raises:
        DesignError: if the text is invalid.
    """
    return parse_toml(
        text,
        file_name,
        Design,
        _TABLES,
        lambda design: _check(design, folder),
        lambda values: add_instrument_items(values, folder),
    )


def _check(design: Design, folder: Path) -> None:
    """Raises ``ValidationError`` for the first invalid value of the design."""
    if design.site:
        check_id(("site",), design.site, ())
    _check_names(("tasks",), design.tasks, TASKS)
    _check_names(("robots",), design.robots, ROBOTS)
    for index, robot in enumerate(design.robots):
        for task in design.tasks:
            if make_environment_id(task, robot) not in ENVIRONMENTS:
                raise ValidationError(
                    ("robots", index),
                    f"there is no environment of {robot} with {task}; `avrgym envs` lists all environments",
                )
            _check_settings(make_environment_id(task, robot), design)
    for task in design.goals:
        check_known_name(("goals", task), task, TASKS)
    check_unique_names(("policies",), design.policies)
    for index, policy in enumerate(design.policies):
        check_name_pattern(
            ("policies", index),
            policy,
            _POLICY,
            "the name of a policy, MODULE:ATTRIBUTE, lerobot:FOLDER, or a folder in the study's folder",
        )
    if design.practice_policy:
        check_name_pattern(
            ("practice_policy",), design.practice_policy, _POLICY, "the name of a policy, or an empty text"
        )
    _check_conditions(design)
    check_questionnaires(design.questionnaires)
    check_stop_rules(design.stop_rule_set)
    _check_streams(design.streams)
    _check_inclusion(design.inclusion)
    _check_database(design.database.url)
    _check_object_store(design.recordings.url)
    check_retention(design.retention)
    check_translations(design, folder)


def _check_settings(environment: str, design: Design) -> None:
    """Raises ``ValidationError`` for settings that are not possible in an environment."""
    for name in ("", *design.conditions):
        place = ("conditions", name, "settings") if name else ("settings",)
        settings = design.find_condition_settings(name)
        drawn = [each for each in PERSON_SETTINGS if each in settings.changed_values]
        if drawn:
            raise ValidationError(
                (*place, drawn[0]), "participants have their own bodies; remove this setting of the person"
            )
        try:
            find_task_and_scene(environment, settings)
        except ValueError as error:
            raise ValidationError(place, str(error)) from error


def _check_conditions(design: Design) -> None:
    for name, rules in design.conditions.items():
        place = ("conditions", name)
        if "control_hz" in rules.settings.changed_values:
            raise ValidationError(
                (*place, "settings", "control_hz"),
                "the trials of all conditions have the same control rate; allowed: control_hz in [settings]",
            )
        check_known_name(place, name, (*design.policies, design.practice_policy))
        check_name_pattern((*place, "policy"), rules.policy, _POLICY, "the name of a policy")
        if rules.policy in design.conditions:
            raise ValidationError(
                (*place, "policy"), f"{rules.policy!r} is a condition; allowed: the name of a policy"
            )
        for field in ("commands", "sources"):
            check_unique_names((*place, field), getattr(rules, field))
        try:
            apply_preferences(rules, None)
        except ValueError as error:
            raise ValidationError(place, str(error)) from error


def _check_names(place: ValuePath, names: tuple[str, ...], allowed: Mapping[str, Any]) -> None:
    for index, name in enumerate(names):
        check_known_name((*place, index), name, allowed)
    check_unique_names(place, names)


def _check_inclusion(questions: Iterable[InclusionQuestion]) -> None:
    known: set[str] = set()
    for index, question in enumerate(questions):
        check_id(("inclusion", index, "id"), question.id, known)
        known.add(question.id)


def _check_streams(streams: StreamSettings) -> None:
    for name, query in streams.receive.items():
        fault = find_stream_error(name, query)
        if fault:
            raise ValidationError(("streams", "receive", name), fault)


def _check_database(url: str) -> None:
    if url and not url.startswith("postgresql://"):
        raise ValidationError(
            ("database", "url"), 'not a database URL; allowed: "" or postgresql://user@host/name'
        )


def _check_object_store(url: str) -> None:
    if url and not OBJECT_STORE_URL_PATTERN.fullmatch(url):
        raise ValidationError(
            ("recordings", "url"), 'not an address of an object store; allowed: "" or s3://bucket/folder'
        )


_TABLES: StructByKeyPath = {
    ("consent",): ConsentConfig,
    ("inclusion",): InclusionQuestion,
    ("questionnaires",): Questionnaire,
    ("questionnaires", "items"): Item,
    ("stop_rules",): StopRule,
    ("database",): DatabaseConfig,
    ("recordings",): RecordingsConfig,
    ("furniture",): RealFurniture,
    ("settings",): Settings,
    ("sessions",): SessionRules,
    ("conditions",): Condition,
    ("conditions", "settings"): Settings,
    ("conditions", "defaults"): Preferences,
    ("conditions", "thresholds"): GestureThresholds,
    ("streams",): StreamSettings,
    ("reporting",): PublicationDetails,
    ("retention",): RetentionPeriods,
}
