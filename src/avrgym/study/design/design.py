"""A study's design: what ``study.toml`` says, checked."""

import re
from collections.abc import Iterable, Mapping
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np

from avrgym.models.furniture.real import RealFurniture
from avrgym.recording.questionnaire import ITEM_ORDERS, MOMENTS, Item, Questionnaire, items_to_ask
from avrgym.robots.registry import ROBOTS
from avrgym.study.design.toml import DesignError as DesignError
from avrgym.study.design.toml import Tables, Wrong, parse, read_text
from avrgym.system.toml_places import Place
from avrgym.tasks.registry import ENVIRONMENTS, TASKS, environment_id

FILE = "study.toml"
PROTOCOL = ("seed", "tasks", "robots", "policies", "practice_policy", "trial_steps")
"""What must stay as it is once a participant has been given an order."""

Sentence = Annotated[str, msgspec.Meta(min_length=1, max_length=160)]
Names = Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=8)]
_NAME = re.compile(r"[A-Za-z0-9_-]{1,40}")
_POLICY = re.compile(r"(?!.*\.\.)[A-Za-z0-9_-][A-Za-z0-9_./:-]{0,79}")


class Consent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What participants agree to."""

    version: Annotated[str, msgspec.Meta(min_length=1)]
    text: Annotated[str, msgspec.Meta(min_length=1)]


class InclusionQuestion(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A yes-no question; whoever does not answer ``required`` cannot take part."""

    id: str
    text: Annotated[str, msgspec.Meta(min_length=1)]
    required: bool


class DatabaseChoice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the study's rows are kept; without a URL in ``study.db`` beside the design."""

    url: str = ""


class Reporting(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a publication says of a study and no recording knows; empty until it is known."""

    ethics_approval: str = ""
    recruitment: str = ""
    compensation: str = ""


class Design(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A whole study.

    ``trial_steps`` are control steps of 0.1 s. An empty ``practice_policy`` means no practice trials. ``goals`` tell
    participants what a task is, by task; where one is missing, the task's own sentence does. ``furniture`` is what they
    really sit and lie on.
    A trial whose person was held for more than ``max_held_share`` of the time in which the robot helped enters no
    analysis; a design that does not say counts all. ``force_guard``: arms that press too hard draw back; a design that
    does not say has none, as studies that began without it.
    """

    title: Annotated[str, msgspec.Meta(min_length=1)]
    participants: Annotated[int, msgspec.Meta(ge=1)]
    seed: Annotated[int, msgspec.Meta(ge=0)]
    tasks: Names
    robots: Names
    policies: Names
    practice_policy: str
    trial_steps: Annotated[int, msgspec.Meta(ge=1)]
    free_movement_s: Annotated[float, msgspec.Meta(ge=0, le=600)]
    blind_experimenter: bool
    max_held_share: Annotated[float, msgspec.Meta(ge=0, le=1)] = 1.0
    force_guard: bool = False
    consent: Consent
    inclusion: tuple[InclusionQuestion, ...] = ()
    questionnaires: tuple[Questionnaire, ...] = ()
    goals: Mapping[str, Sentence] = {}
    furniture: RealFurniture = RealFurniture()
    reporting: Reporting = Reporting()
    database: DatabaseChoice = DatabaseChoice()

    @property
    def conditions(self) -> tuple[tuple[str, str], ...]:
        """Every robot with every policy."""
        return tuple(product(self.robots, self.policies))

    @property
    def items(self) -> dict[str, Item]:
        """Every item of every questionnaire by its id."""
        return {item.id: item for questionnaire in self.questionnaires for item in questionnaire.items}

    def questionnaire_of(self, item: str) -> Questionnaire | None:
        """The questionnaire that an item stands in; ``None`` for one that the design no longer asks."""
        return next((each for each in self.questionnaires for own in each.items if own.id == item), None)

    def items_at(self, when: str, seed: int = 0) -> tuple[Item, ...]:
        """The items to ask at a moment, in order; ``seed`` is that of the trial."""
        return items_to_ask(self.questionnaires, when, seed)

    def protocol(self) -> dict[str, Any]:
        """The fields that orders and trials follow from, as JSON has them."""
        plain = msgspec.json.decode(msgspec.json.encode(self))
        return {name: plain[name] for name in PROTOCOL}

    def policy_codes(self) -> dict[str, str]:
        """A letter for each policy, for whoever must not know which it is; the seed decides."""
        order = np.random.default_rng([self.seed, len(self.policies)]).permutation(len(self.policies))
        return {policy: chr(ord("A") + place) for policy, place in zip(self.policies, order, strict=True)}

    def shown_policy(self, policy: str, practice: bool) -> str:
        """A trial's policy as the experimenter may see it; all of them know what practice is done with."""
        if not self.blind_experimenter:
            return policy
        return "practice" if practice else self.policy_codes()[policy]


def default_text() -> str:
    """The paper's protocol with comments, as ``study.toml`` holds it."""
    return (files("avrgym") / "assets" / FILE).read_text(encoding="utf-8")


def read_design(path: Path) -> Design:
    """Read a design from a file.

    Raises:
        DesignError: when the file says what cannot be.
        OSError: when it cannot be read.
    """
    return parse_design(read_text(path), str(path))


def parse_design(text: str, name: str = FILE) -> Design:
    """The design that a text holds; ``name`` stands in errors, which are ``DesignError``."""
    return parse(text, name, Design, _TABLES, _check)


def _check(design: Design) -> None:
    """Raise ``Wrong`` for the first value that no type forbids but that cannot be."""
    _check_names(("tasks",), design.tasks, TASKS)
    _check_names(("robots",), design.robots, ROBOTS)
    for index, robot in enumerate(design.robots):
        for task in design.tasks:
            if environment_id(task, robot) not in ENVIRONMENTS:
                raise Wrong(
                    ("robots", index), f"{robot} cannot do {task}; `avrgym envs` lists who can do what"
                )
    for task in design.goals:
        _check_known(("goals", task), task, TASKS)
    _check_unique(("policies",), design.policies)
    for index, policy in enumerate(design.policies):
        _check_pattern(
            ("policies", index),
            policy,
            _POLICY,
            "a packaged policy or another by its name, MODULE:ATTRIBUTE, or a folder in the study's folder",
        )
    if design.practice_policy:
        _check_pattern(("practice_policy",), design.practice_policy, _POLICY, "a policy, or nothing")
    _check_questionnaires(design)
    _check_ids("inclusion", design.inclusion)
    _check_database(design.database.url)


def _check_names(place: Place, names: tuple[str, ...], allowed: Mapping[str, Any]) -> None:
    for index, name in enumerate(names):
        _check_known((*place, index), name, allowed)
    _check_unique(place, names)


def _check_known(place: Place, name: str, allowed: Mapping[str, Any]) -> None:
    if name not in allowed:
        raise Wrong(place, f"unknown name {name!r}; allowed: {', '.join(allowed)}")


def _check_unique(place: Place, names: tuple[str, ...]) -> None:
    for index, name in enumerate(names):
        if name in names[:index]:
            raise Wrong((*place, index), f"{name!r} stands here twice; allowed: once")


def _check_pattern(place: Place, name: str, pattern: re.Pattern[str], what: str) -> None:
    if not pattern.fullmatch(name):
        raise Wrong(place, f"{name!r} is no name; allowed: {what}, in letters, digits, - and _")


def _check_ids(table: str, questions: Iterable[InclusionQuestion | Questionnaire]) -> None:
    known: set[str] = set()
    for index, question in enumerate(questions):
        key = "id" if isinstance(question, InclusionQuestion) else "name"
        name = getattr(question, key)
        _check_id((table, index, key), name, known)


def _check_id(place: Place, name: str, known: set[str]) -> None:
    _check_pattern(place, name, _NAME, "at most 40 characters")
    if name in known:
        raise Wrong(place, f"{name!r} stands twice; allowed: a name that no other has")
    known.add(name)


def _check_questionnaires(design: Design) -> None:
    _check_ids("questionnaires", design.questionnaires)
    known: set[str] = set()
    for index, questionnaire in enumerate(design.questionnaires):
        place = ("questionnaires", index)
        for moment in questionnaire.moments:
            _check_choice((*place, "when"), moment, MOMENTS)
        _check_unique((*place, "when"), questionnaire.moments)
        _check_choice((*place, "order"), questionnaire.order, ITEM_ORDERS)
        for number, item in enumerate(questionnaire.items):
            _check_id((*place, "items", number, "id"), item.id, known)


def _check_choice(place: Place, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise Wrong(place, f"{value!r} is not known; allowed: {', '.join(allowed)}")


def _check_database(url: str) -> None:
    if url and not url.startswith("postgresql://"):
        raise Wrong(("database", "url"), 'not a database; allowed: "" or postgresql://user@host/name')


_TABLES: Tables = {
    ("consent",): Consent,
    ("inclusion",): InclusionQuestion,
    ("questionnaires",): Questionnaire,
    ("questionnaires", "items"): Item,
    ("database",): DatabaseChoice,
    ("furniture",): RealFurniture,
    ("reporting",): Reporting,
}
