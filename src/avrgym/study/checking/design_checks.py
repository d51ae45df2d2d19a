"""Checking a study: whether everybody took part with the same design, and whether it is the one in its folder."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import msgspec

from avrgym.study.checking.finding import Finding
from avrgym.study.design.comparison import Wordings, differences, fixed_values, named, read_wordings, shown
from avrgym.study.design.design import FILE, Design
from avrgym.study.design.languages import sentences
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.session_designs import (
    Use,
    design_of,
    designs_recorded,
    designs_used,
    is_of_sites,
    listed,
)
from avrgym.study.storage.store import Store
from avrgym.system.toml_lines import Place
from avrgym.texts.interface_texts import FOLDER as TEXTS
from avrgym.texts.interface_texts import TextsError, normalize_whitespace

AT_ADMISSION = ("inclusion", "order of inclusion")
"""Fields that participants answer before the first session."""
CONSENT = "consent"
"""Stored with each participant, and checked with that."""
NOT_FOR_PARTICIPANTS = ("title", "participants", "max_held_share", "max_repeats")
"""Fields that change nothing for participants: a difference is a note."""


@dataclass(frozen=True)
class Difference:
    """A value ``here`` in one design that is another, ``there``, in ``uses``; either may be ``NOTHING``."""

    file: str
    place: Place
    here: Any
    there: Any
    uses: list[Use]


def check_design(store: Store) -> Iterator[Finding]:
    """Differences between the designs that participants took part with and the one in the study's folder."""
    uses = designs_used(store)
    for each in differences_of(store.design, _present_wordings(store), uses):
        wrong = each.place[0] not in NOT_FOR_PARTICIPANTS and not is_of_sites(store, each.uses, uses)
        what = f"{named(each.place)} is {shown(each.here)}; it was {shown(each.there)} for"
        yield Finding(each.file, f"{what} {listed(each.uses, uses)}", wrong=wrong)
    yield from _check_inclusion(store)
    yield from _check_recordings(store, uses)


def check_stored_designs(store: Store) -> Iterator[Finding]:
    """Sessions whose design the database does not contain, such as those of an earlier version."""
    uses = designs_used(store)
    unknown = [use for use in uses if use.wordings is None]
    if unknown:
        what = f"does not contain the design of {listed(unknown, uses)}: only their recordings report it, in part"
        yield Finding("database", what, wrong=False)


def differences_of(design: Design, wordings: Wordings | None, uses: Sequence[Use]) -> list[Difference]:
    """Each difference between a design and those that people took part with."""
    found: dict[str, Difference] = {}
    known: dict[bytes, list[Difference]] = {}
    for use in uses:
        key = msgspec.json.encode([use.design, use.wordings, use.language], order="deterministic")
        if key not in known:
            known[key] = list(_differences(design, wordings, use))
        for each in known[key]:
            name = f"{each.file} {each.place} {each.there!r}"
            found.setdefault(name, replace(each, uses=[])).uses.append(use)
    return list(found.values())


def _differences(design: Design, wordings: Wordings | None, use: Use) -> Iterator[Difference]:
    for place, here, there in differences(_of_sessions(design), _of_sessions(use.design)):
        yield Difference(FILE, place, here, there, [])
    if wordings is None or use.wordings is None:
        return
    language = use.language
    for place, here, there in differences(wordings.get(language, {}), use.wordings.get(language, {})):
        if place[0] != "sentences" or place[-1] in _both(design, use.design):
            yield Difference(f"{TEXTS}/{language}.toml", place, here, there, [])


def _of_sessions(design: Design) -> dict[str, Any]:
    """The fields of a design that apply from the first session on."""
    before = (*AT_ADMISSION, CONSENT)
    return {name: value for name, value in fixed_values(design).items() if name not in before}


def _both(a: Design, b: Design) -> set[str]:
    """The sentences that two designs have in common."""
    first, second = ({normalize_whitespace(each) for each in sentences(design)} for design in (a, b))
    return first & second


def _present_wordings(store: Store) -> Wordings | None:
    try:
        return read_wordings(store.design, store.folder)
    except TextsError:
        return None


def _check_inclusion(store: Store) -> Iterator[Finding]:
    """Inclusion questions that participants answered in other words, or that were not asked."""
    for (place, here, there), people in admission_differences(store, store.design, AT_ADMISSION):
        what = f"{named(place)} is {shown(here)}; it was {shown(there)} for"
        yield Finding(FILE, f"{what} {', '.join(people)}")


def admission_differences(
    store: Store, design: Design, fields: Sequence[str]
) -> list[tuple[tuple[Place, Any, Any], list[str]]]:
    """Each difference between fields of a design and those that participants were taken in with, and who they are."""
    found: dict[str, tuple[tuple[Place, Any, Any], list[str]]] = {}
    expected = {name: fixed_values(design)[name] for name in fields}
    for row in store.designs():
        if row.session is None:
            asked = fixed_values(design_of(row))
            for change in differences(expected, {name: asked[name] for name in fields}):
                found.setdefault(repr(change), (change, []))[1].append(pseudonym_of(row.participant))
    return list(found.values())


def _check_recordings(store: Store, uses: Sequence[Use]) -> Iterator[Finding]:
    """Differences between recordings and the design of their session.

    The real seat may differ in a session; every other difference is an error.
    """
    stored = {use.session.id: use for use in uses if use.wordings is not None}
    for use in designs_recorded(store):
        own = stored.get(use.session.id)
        if own is None:
            continue
        for place, before, then in differences(_of_sessions(own.design), _of_sessions(use.design)):
            yield Finding(
                str(use.session),
                f"was recorded with another {named(place)} than its design has: {shown(then)} instead of "
                f"{shown(before)}, for {listed([use])}",
                wrong=place[0] != "furniture",
            )
