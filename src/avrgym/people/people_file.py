"""Files of people: TOML that ``avrgym fit-people`` writes and that may be changed by hand.

A joint's range is given in degrees; what has no range keeps the task's own pose.
"""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from avrgym.models.human import JOINTS, TORSO_HEIGHT_RANGE_M
from avrgym.system.files import read_user_text
from avrgym.system.type_guards import is_array, is_table

Range = tuple[float, float]


class PeopleFileError(ValueError):
    """A file of people with an invalid value; the message names the file, the value and what is allowed."""


class Source(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where the ranges come from: a study's title, how many men, women and trials, and whether they were simulated."""

    study: str
    men: int
    women: int
    trials: int
    simulated: bool

    @property
    def participants(self) -> int:
        """How many there were."""
        return self.men + self.women


class TorsoHeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Lowest and highest torso heights in metres."""

    man: Range
    woman: Range


class PeopleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a file holds. ``cooperating``: they move, see ``people.behaviour``; ``source``: nothing when made by hand.

    ``poses``: by task and joint, the lowest and highest angle in degrees at which people sit or lie.
    """

    cooperating: bool
    torso_height_m: TorsoHeights
    poses: dict[str, dict[str, Range]] = {}
    source: Source | None = None


def read_people(path: Path, tasks: Collection[str]) -> PeopleFile:
    """Read a file of people, who may have poses for any of ``tasks``.

    Raises:
        PeopleFileError: when it says what cannot be.
        OSError: when it cannot be read.
    """
    try:
        return parse_people(read_user_text(path), str(path), tasks)
    except UnicodeDecodeError as error:
        raise PeopleFileError(
            f"{path}: not text in UTF-8: {error.reason} at byte {error.start}; save it as UTF-8"
        ) from None


def parse_people(text: str, name: str, tasks: Collection[str]) -> PeopleFile:
    """The people that a text holds; ``name`` stands in errors, which are ``PeopleFileError``."""
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PeopleFileError(f"{name}: not TOML: {error}") from None
    for message in _mistakes(values, tasks):
        raise PeopleFileError(f"{name}: {message}")
    try:
        return msgspec.convert(values, PeopleFile)
    except msgspec.ValidationError as error:
        message, _, path = str(error).replace("`", "").partition(" - at $.")
        raise PeopleFileError(f"{name}: {path}: {message}" if path else f"{name}: {message}") from None


def _mistakes(values: Mapping[str, Any], tasks: Collection[str]) -> Iterator[str]:
    """Values that have the right type but are invalid, and what is allowed."""
    for sex, heights in _table(values, "torso_height_m").items():
        yield from _range_mistakes(f"torso_height_m.{sex}", heights, TORSO_HEIGHT_RANGE_M, "m")
    poses = _table(values, "poses")
    for task in poses:
        if task not in tasks:
            yield f"poses: unknown task {task!r}; allowed: {', '.join(tasks)}"
        for joint, angles in _table(poses, task).items():
            if joint not in JOINTS:
                yield f"poses.{task}: unknown joint {joint!r}; allowed: {', '.join(JOINTS)}"
                continue
            limits = JOINTS[joint].lower_deg, JOINTS[joint].upper_deg
            yield from _range_mistakes(f"poses.{task}.{joint}", angles, limits, "degrees")


def _table(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = values.get(name)
    return found if is_table(found) else {}


def _range_mistakes(place: str, found: Any, limits: Range, unit: str) -> Iterator[str]:
    numbers = is_array(found) and len(found) == 2 and all(isinstance(n, int | float) for n in found)
    if not (numbers and limits[0] <= found[0] <= found[1] <= limits[1]):
        low, high = limits
        yield f"{place} is {found}; allowed: [lowest, highest] within {low:g} to {high:g} {unit}"
