"""Whether studies are the same: design, plan and policies, compared by value."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import msgspec

from avrgym.study.checking.policy_files import policy_files
from avrgym.study.design.comparison import differences, place_text, value_text
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import SITE_FIELDS
from avrgym.study.design.validation import read_text
from avrgym.study.plan.frozen_plan import FROZEN, read_frozen_plan
from avrgym.study.plan.plan import FILE as PLAN
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.system.toml_lines import Place, line_of
from avrgym.texts.interface_texts import read_texts

MUST_AGREE = ("tasks", "robots", "policies", "practice_policy")
"""Without these there is nothing to be taken together."""
NamedStudy = tuple[str, Store]
"""A study with its site's name."""


def find_differences(a: NamedStudy, b: NamedStudy, *, accepted: bool) -> list[str]:
    """In what two studies differ, in words.

    Raises:
        StudyError: where they differ in anything that was not ``accepted``, or that never can be.
    """
    designs = list(differences(_design(a[1]), _design(b[1])))
    never = [each for each in designs if each[0][0] in MUST_AGREE]
    if never:
        words = "; ".join(_of_designs(a, b, *each) for each in never)
        raise StudyError(
            f"nothing was merged: {words}; studies with other tasks, robots or policies are never merged"
        )
    found = [_of_designs(a, b, *each) for each in designs]
    found += [_told(*each, a[0], b[0]) for each in _beside_designs(a[1], b[1])]
    if found and not accepted:
        raise StudyError(
            f"nothing was merged: {'; '.join(found)}; --accept-differences merges them all the same"
        )
    return found


def _beside_designs(a: Store, b: Store) -> Iterator[tuple[str, Any, Any]]:
    for place, here, there in differences(_texts(a), _texts(b)):
        yield f"texts in {place_text(place)}", here, there
    for place, here, there in differences(_policies(a), _policies(b)):
        yield f"the checksum of {place_text(place)}", here, there
    if _plan(a) != _plan(b):
        yield f"the frozen plan's checksum ({FROZEN})", _plan(a), _plan(b)


def _of_designs(a: NamedStudy, b: NamedStudy, place: Place, here: Any, there: Any) -> str:
    """A difference of designs, with the lines where their files say so."""
    at = [f"{name}{_line(store, place)}" for name, store in (a, b)]
    return _told(f"{DESIGN}: {place_text(place)}", here, there, *at)


def _told(where: str, here: Any, there: Any, a: str, b: str) -> str:
    return f"{where} is {value_text(here)} at {a}, {value_text(there)} at {b}"


def _line(store: Store, place: Place) -> str:
    """The line of a value, or of what it belongs to; nothing where a design does not say it."""
    text = read_text(store.folder / DESIGN)
    for length in range(len(place), 0, -1):
        try:
            return f" (line {line_of(text, place[:length])})"
        except LookupError:
            continue
    return ""


def _design(store: Store) -> dict[str, Any]:
    """What a design says for all sites, with the words of instruments."""
    values = msgspec.json.decode(msgspec.json.encode(store.design))
    return {name: value for name, value in values.items() if name not in SITE_FIELDS}


def _texts(store: Store) -> dict[str, Any]:
    """What participants read in each language."""
    return {language: asdict(read_texts(language, store.folder)) for language in store.design.languages}


def _policies(store: Store) -> dict[str, str | None]:
    return {f"{each.policy} of {each.environment}": each.sha256 for each in policy_files(store)}


def _plan(store: Store) -> str:
    frozen = read_frozen_plan(store)
    if frozen is None:
        return "none"
    return (
        f"unknown, as it {'; '.join(frozen.faults)}" if frozen.record is None else frozen.record.sha256[PLAN]
    )
