"""Deviations of a study's design and texts from the frozen ones: of the present ones, and of those in sessions."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import tomlkit

from avrgym.study.checking.design_checks import (
    AT_ADMISSION,
    CONSENT,
    admission_differences,
    differences_of,
)
from avrgym.study.checking.finding import Finding
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import Design, DesignError, parse_design
from avrgym.study.design.differences import NOTHING, differences, named, shown
from avrgym.study.design.fixed import NOT_FIXED, Wordings, fixed_values, read_wordings
from avrgym.study.design.word_files import word_files
from avrgym.study.plan.freezing import FROZEN, Record, sha256
from avrgym.study.storage.store import Store
from avrgym.study.storage.uses import designs_used, listed
from avrgym.system.toml_places import Place
from avrgym.system.user_text import both_forms
from avrgym.texts.texts import TextsError

Change = tuple[Place, Any, Any]
"""A place, and the values there before and after, of which one may be ``NOTHING``."""


def design_deviations(store: Store, record: Record) -> Iterator[Finding]:
    """Each difference of the design, and of the texts for participants, from the frozen plan.

    Differences in sessions are listed even if the files are as planned again.
    """
    frozen = frozen_design(record)
    had = _had(store, *frozen) if frozen else {}
    for name, before in {DESIGN: record.design, **(record.words or {})}.items():
        fault, changes = _compared(store, record, name, before, frozen[0] if frozen else None)
        if fault:
            yield deviation(name, fault)
        for change in changes:
            _, who = had.pop((name, change[0], shown(change[2])), (None, ""))
            yield deviation(name, changed(*change) + (f", for {who}" if who else ""))
    for (name, place, value), (before, who) in had.items():
        yield deviation(name, f"{named(place)} was {before} in the plan and {value} for {who}")
    for name in word_files(store.design, store.folder):
        if record.words is not None and name not in record.words:
            yield deviation(name, "was added")


def _had(
    store: Store, design: Design, wordings: Wordings | None
) -> dict[tuple[str, Place, str], tuple[str, str]]:
    """The frozen value and the participants, by file, place and the other value that they had."""
    uses = designs_used(store)
    found = {
        (each.file, each.place, shown(each.there)): (shown(each.here), listed(each.uses, uses))
        for each in differences_of(design, wordings, uses)
    }
    admitted = admission_differences(store, design, (CONSENT, *AT_ADMISSION))
    return found | {
        (DESIGN, place, shown(there)): (shown(here), ", ".join(people))
        for (place, here, there), people in admitted
    }


def changed_file(store: Store, record: Record, name: str, before: str) -> Iterator[Finding]:
    """Each difference of any other file from the frozen one."""
    fault, changes = _compared(store, record, name, before, None)
    if fault:
        yield deviation(name, fault)
    yield from (deviation(name, changed(*change)) for change in changes)


def frozen_design(record: Record) -> tuple[Design, Wordings | None] | None:
    """The design and the wordings of a frozen plan; ``None`` where this version cannot read them."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, text in (record.words or {}).items():
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                return None
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        try:
            design = parse_design(record.design, FROZEN, folder)
            return design, None if record.words is None else read_wordings(design, folder)
        except (DesignError, TextsError):
            return None


def _compared(
    store: Store, record: Record, name: str, before: str, frozen: Design | None
) -> tuple[str, list[Change]]:
    """The fault of a file as a whole, and its differences from the frozen text."""
    path = store.folder / name
    if not path.is_file():
        return "is gone", []
    data = path.read_bytes()
    if record.sha256[name] in map(sha256, both_forms(data)):
        return "", []
    try:
        after = tomlkit.parse(both_forms(data)[0].decode()).unwrap()
    except ValueError:
        return "was changed and can no longer be read", []
    values = tomlkit.parse(before).unwrap()
    if values == after:
        return "was changed in comments or layout alone", []
    if name == DESIGN and frozen is not None:
        return "", list(differences(fixed_values(frozen), fixed_values(store.design)))
    return "", list(differences(_shared(values), _shared(after)))


def _shared(values: Mapping[str, Any]) -> dict[str, Any]:
    """The fields of a file that apply to all sites."""
    return {name: value for name, value in values.items() if name not in NOT_FIXED}


def changed(place: Place, before: Any, after: Any) -> str:
    """A difference in words; either value may be ``NOTHING``."""
    if before is NOTHING:
        return f"{named(place)} was added: {shown(after)}"
    if after is NOTHING:
        return f"{named(place)} is gone; it was {shown(before)}"
    return f"{named(place)} was {shown(before)}, is {shown(after)}"


def deviation(where: str, what: str) -> Finding:
    """A difference from a plan; it is a note, not an error."""
    return Finding(where, what, wrong=False)
