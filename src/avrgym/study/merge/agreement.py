"""Whether studies are the same: design, plan and policies, compared by value."""

from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

import msgspec

from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import LOCAL
from avrgym.study.design.differences import differences, shown
from avrgym.study.plan.freezing import FROZEN, policy_files, read_frozen
from avrgym.study.plan.plan import FILE as PLAN
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store
from avrgym.texts.texts import read_texts

MUST_AGREE = tuple(f"{DESIGN}: {name}" for name in ("tasks", "robots", "policies", "practice_policy"))
"""Without these there is nothing to be taken together."""


def disagreements(a: tuple[str, Store], b: tuple[str, Store], *, accepted: bool) -> list[str]:
    """In what two studies differ, in words; each comes with its name.

    Raises:
        StudyError: where they differ in anything that was not ``accepted``, or that never can be.
    """
    found = list(_disagreements(a[1], b[1]))
    words = [f"{place} is {shown(here)} at {a[0]}, {shown(there)} at {b[0]}" for place, here, there in found]
    never = [place for place, *_ in found if place.startswith(MUST_AGREE)]
    if never:
        raise StudyError(
            f"nothing was merged: {'; '.join(words)}; studies with other tasks, robots or policies are never merged"
        )
    if words and not accepted:
        raise StudyError(
            f"nothing was merged: {'; '.join(words)}; --accept-differences merges them all the same"
        )
    return words


def _disagreements(a: Store, b: Store) -> Iterator[tuple[str, Any, Any]]:
    for place, here, there in differences(_design(a), _design(b)):
        yield f"{DESIGN}: {place}", here, there
    for place, here, there in differences(_texts(a), _texts(b)):
        yield f"texts in {place}", here, there
    for place, here, there in differences(_policies(a), _policies(b)):
        yield f"the checksum of {place}", here, there
    if _plan(a) != _plan(b):
        yield f"the frozen plan's checksum ({FROZEN})", _plan(a), _plan(b)


def _design(store: Store) -> dict[str, Any]:
    """What a design says for all sites, with the words of instruments."""
    values = msgspec.json.decode(msgspec.json.encode(store.design))
    return {name: value for name, value in values.items() if name not in LOCAL}


def _texts(store: Store) -> dict[str, Any]:
    """What participants read in each language."""
    return {language: asdict(read_texts(language, store.folder)) for language in store.design.languages}


def _policies(store: Store) -> dict[str, str | None]:
    return {f"{each.policy} of {each.environment}": each.sha256 for each in policy_files(store)}


def _plan(store: Store) -> str:
    frozen = read_frozen(store)
    if frozen is None:
        return "none"
    return f"unknown, as it {frozen.fault}" if frozen.record is None else frozen.record.sha256[PLAN]
