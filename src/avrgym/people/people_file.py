"""People files: TOML files written by ``avrgym fit-people``. Users may edit them.

They contain ranges of initial joint angles by task, in degrees. Without a range, a joint has the initial angle of the
task. They may also contain behaviour parameters that were estimated from participants.
"""

import tomllib
from collections.abc import Collection, Iterator, Mapping
from math import inf
from pathlib import Path
from typing import Any

import msgspec

from avrgym.models.human import JOINTS, TORSO_HEIGHT_RANGE_M
from avrgym.people.zoo.partners import DEFAULT_PARAMETER_BOUNDS, PARAMETER_BOUNDS, PARAMETER_NAMES
from avrgym.system.files import read_user_text
from avrgym.system.type_guards import is_array, is_table

ValueRange = tuple[float, float]
MeanAndStandardDeviation = tuple[float, float]
"""Mean and standard deviation of a behaviour parameter of one participant."""


class PeopleFileError(ValueError):
    """Raised for an invalid value in a people file. The message contains the file, the value and the allowed values."""


class FittedStudy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The study from which the ranges of a people file were estimated: its name, and numbers of participants and
    trials.
    """

    study: str
    men: int
    women: int
    trials: int
    simulated: bool

    @property
    def participants(self) -> int:
        """Number of participants, men and women."""
        return self.men + self.women


class TorsoHeights(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Lowest and highest torso height of men and of women, in metres."""

    man: ValueRange
    woman: ValueRange


class PeopleFile(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Content of a people file.

    Attributes:
        cooperating: whether people move towards the tool, see ``people.cooperation``.
        torso_height_m: ranges of torso height of men and women.
        poses: lowest and highest joint angle in degrees, by task and joint.
        source: the study; ``None`` for a file that was not fitted to a study.
        behaviour: for each participant, estimates of ``BehaviourParameters``. A sampled person behaves like one of the
            participants. Without estimates, ``cooperating`` determines the behaviour.
    """

    cooperating: bool
    torso_height_m: TorsoHeights
    poses: dict[str, dict[str, ValueRange]] = {}
    source: FittedStudy | None = None
    behaviour: tuple[dict[str, MeanAndStandardDeviation], ...] = ()


def read_people(path: Path, tasks: Collection[str]) -> PeopleFile:
    """Returns the content of a people file. The file may contain poses for any of ``tasks``.

    Raises:
        PeopleFileError: for an invalid value.
        OSError: if the file cannot be read.
    """
    try:
        return parse_people(read_user_text(path), str(path), tasks)
    except UnicodeDecodeError as error:
        raise PeopleFileError(
            f"{path}: the file is not UTF-8 text: {error.reason} at byte {error.start}; save it as UTF-8"
        ) from None


def parse_people(text: str, name: str, tasks: Collection[str]) -> PeopleFile:
    """Returns the content of a people file, given its text. Error messages begin with ``name``.

    Raises:
        PeopleFileError: for an invalid value.
    """
    try:
        values = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise PeopleFileError(f"{name}: invalid TOML: {error}; correct this line") from None
    for message in _mistakes(values, tasks):
        raise PeopleFileError(f"{name}: {message}")
    try:
        return msgspec.convert(values, PeopleFile)
    except msgspec.ValidationError as error:
        message, _, path = str(error).replace("`", "").partition(" - at $.")
        raise PeopleFileError(f"{name}: {path}: {message}" if path else f"{name}: {message}") from None


def _mistakes(values: Mapping[str, Any], tasks: Collection[str]) -> Iterator[str]:
    """Yields an error message for each value that has the correct type but is not allowed."""
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
            limits = JOINTS[joint].lower_limit_deg, JOINTS[joint].upper_limit_deg
            yield from _range_mistakes(f"poses.{task}.{joint}", angles, limits, "degrees")
    participants = values.get("behaviour")
    for number, estimates in enumerate(participants if is_array(participants) else (), start=1):
        for name, estimate in estimates.items() if is_table(estimates) else ():
            yield from _estimate_mistakes(f"behaviour {number}: {name}", name, estimate)


def _estimate_mistakes(place: str, name: str, found: Any) -> Iterator[str]:
    if name not in PARAMETER_NAMES:
        yield f"{place}: unknown parameter; allowed: {', '.join(PARAMETER_NAMES)}"
        return
    low, high = PARAMETER_BOUNDS.get(name, DEFAULT_PARAMETER_BOUNDS)
    if not (_are_numbers(found) and low <= found[0] <= high and 0.0 <= found[1] < inf):
        yield f"{place} is {found}; allowed: [mean from {low:g} to {high:g}, standard deviation of 0 or more]"


def _table(values: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = values.get(name)
    return found if is_table(found) else {}


def _range_mistakes(place: str, found: Any, limits: ValueRange, unit: str) -> Iterator[str]:
    if not (_are_numbers(found) and limits[0] <= found[0] <= found[1] <= limits[1]):
        low, high = limits
        yield f"{place} is {found}; allowed: [lowest, highest], both from {low:g} to {high:g} {unit}"


def _are_numbers(found: Any) -> bool:
    """Returns whether a value is an array of two numbers."""
    return is_array(found) and len(found) == 2 and all(isinstance(n, int | float) for n in found)
