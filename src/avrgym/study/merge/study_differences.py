"""Compare studies before a merge: their designs, texts, policies and plans."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import msgspec

from avrgym.study.checking.policy_files import find_policy_files
from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import SITE_SPECIFIC_FIELDS
from avrgym.study.design.design_comparison import find_value_differences, format_key_path, format_value
from avrgym.study.design.toml_validation import read_text
from avrgym.study.plan.analysis_plan import PLAN_FILE as PLAN
from avrgym.study.plan.frozen_plan import FROZEN_PLAN_FILE, read_frozen_plan_evidence
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.toml_lines import ValuePath, find_line_number
from avrgym.texts.interface_texts import read_texts

REQUIRED_EQUAL_FIELDS = ("tasks", "robots", "policies", "practice_policy")
"""Design fields that must be equal at all sites. Differences in these fields are never accepted."""
NamedStudy = tuple[str, StudyStore]
"""Name and study of a site."""


def find_study_differences(a: NamedStudy, b: NamedStudy, *, accepted: bool) -> list[str]:
    """Returns the descriptions of the differences between two studies.

    ``accepted``: the user accepts differences.

    Raises:
        StudyError: for a difference in ``REQUIRED_EQUAL_FIELDS``. Also for any difference if ``accepted`` is false.
    """
    designs = list(find_value_differences(_design(a[1]), _design(b[1])))
    never = [each for each in designs if each[0][0] in REQUIRED_EQUAL_FIELDS]
    if never:
        words = "; ".join(_of_designs(a, b, *each) for each in never)
        raise StudyError(
            f"nothing was merged: {words}; tasks, robots and policies of all sites must be equal"
        )
    found = [_of_designs(a, b, *each) for each in designs]
    found += [_difference_text(*each, a[0], b[0]) for each in _other_differences(a[1], b[1])]
    if found and not accepted:
        raise StudyError(f"nothing was merged: {'; '.join(found)}; use --accept-differences to merge them")
    return found


def _other_differences(a: StudyStore, b: StudyStore) -> Iterator[tuple[str, Any, Any]]:
    for place, here, there in find_value_differences(_texts(a), _texts(b)):
        yield f"texts in {format_key_path(place)}", here, there
    for place, here, there in find_value_differences(_policies(a), _policies(b)):
        yield f"the checksum of {format_key_path(place)}", here, there
    if _plan(a) != _plan(b):
        yield f"the frozen plan's checksum ({FROZEN_PLAN_FILE})", _plan(a), _plan(b)


def _of_designs(a: NamedStudy, b: NamedStudy, place: ValuePath, here: Any, there: Any) -> str:
    """Returns a difference between two designs as text, with the line numbers of the value in both ``study.toml``
    files.
    """
    at = [f"{name}{_line(store, place)}" for name, store in (a, b)]
    return _difference_text(f"{DESIGN}: {format_key_path(place)}", here, there, *at)


def _difference_text(where: str, here: Any, there: Any, a: str, b: str) -> str:
    return f"{where} is {format_value(here)} at {a}, {format_value(there)} at {b}"


def _line(store: StudyStore, place: ValuePath) -> str:
    """Returns the line number of a value or of its table as text; empty if the file contains neither."""
    text = read_text(store.folder / DESIGN)
    for length in range(len(place), 0, -1):
        try:
            return f" (line {find_line_number(text, place[:length])})"
        except LookupError:
            continue
    return ""


def _design(store: StudyStore) -> dict[str, Any]:
    """Returns the design's fields, except the fields that may differ between sites."""
    values = msgspec.json.decode(msgspec.json.encode(store.design))
    return {name: value for name, value in values.items() if name not in SITE_SPECIFIC_FIELDS}


def _texts(store: StudyStore) -> dict[str, Any]:
    """Returns the texts for participants, by language."""
    return {language: asdict(read_texts(language, store.folder)) for language in store.design.languages}


def _policies(store: StudyStore) -> dict[str, str | None]:
    return {f"{each.policy} of {each.environment}": each.sha256 for each in find_policy_files(store)}


def _plan(store: StudyStore) -> str:
    frozen = read_frozen_plan_evidence(store)
    if frozen is None:
        return "none"
    return (
        f"unknown ({'; '.join(frozen.error_messages)})"
        if frozen.frozen_plan is None
        else frozen.frozen_plan.sha256[PLAN]
    )
