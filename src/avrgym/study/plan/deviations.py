"""In what a study deviates from its frozen plan, in words."""

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import tomlkit

from avrgym.study.checking.finding import Finding, LeftOut
from avrgym.study.checking.interim_looks import check_interim_looks
from avrgym.study.checking.preflight import plugins_needed
from avrgym.study.design.design import FILE as DESIGN
from avrgym.study.design.design import LOCAL
from avrgym.study.design.differences import NOTHING, differences, named, shown
from avrgym.study.design.word_files import word_files
from avrgym.study.plan.freezing import FROZEN, PolicyFile, Record, policy_files, sha256, software
from avrgym.study.plan.origin import Frozen
from avrgym.study.plan.plan import FILE, NOT_PLANNED, Offered
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.store import Store
from avrgym.system.toml_places import Place
from avrgym.system.used_plugins import differences as plugin_differences
from avrgym.system.user_text import both_forms


def deviations(
    store: Store,
    frozen: Frozen,
    offered: Offered,
    left_out: Sequence[LeftOut] = (),
    besides: Offered = MappingProxyType({}),
) -> list[Finding]:
    """Each difference between a study and its frozen plan.

    Args:
        store: the study.
        frozen: its plan.
        offered: the tests that its analysis does now.
        left_out: the trials that the exclusion rule keeps out of it, as far as they are known.
        besides: what a plan may name too, and what is exploratory where it does not.
    """
    found = [Finding(FROZEN, fault) for fault in frozen.faults]
    if frozen.record is None:
        return found
    return [
        *found,
        *_changed_file(store, frozen.record, DESIGN, frozen.record.design),
        *_changed_file(store, frozen.record, FILE, frozen.record.plan),
        *_words(store, frozen.record),
        *_software(frozen.record),
        *_policies(store, frozen.record),
        *_plugins(store, frozen.record),
        *_people(store, frozen.record),
        *check_interim_looks(store, frozen.record.parsed().participants),
        *left_out,
        *_tests(frozen.record, offered, besides),
    ]


# Files


def _changed_file(store: Store, record: Record, name: str, before: str) -> Iterator[Finding]:
    path = store.folder / name
    if not path.is_file():
        yield _deviation(name, "is gone")
        return
    data = path.read_bytes()
    if record.sha256[name] in map(sha256, both_forms(data)):
        return
    try:
        after = tomlkit.parse(both_forms(data)[0].decode()).unwrap()
    except ValueError:
        yield _deviation(name, "was changed and can no longer be read")
        return
    frozen = tomlkit.parse(before).unwrap()
    for change in differences(_shared(frozen), _shared(after)):
        yield _deviation(name, changed(*change))
    if frozen == after:
        yield _deviation(name, "was changed in comments or layout alone")


def _words(store: Store, record: Record) -> Iterator[Finding]:
    """What participants read otherwise, or besides; a record of an earlier version does not tell."""
    if record.words is None:
        return
    for name, before in record.words.items():
        yield from _changed_file(store, record, name, before)
    for name in word_files(store.design, store.folder):
        if name not in record.words:
            yield _deviation(name, "was added")


def _shared(values: Mapping[str, Any]) -> dict[str, Any]:
    """What a file says for all sites."""
    return {name: value for name, value in values.items() if name not in LOCAL}


def changed(place: Place, before: Any, after: Any) -> str:
    """A difference in words; either value may be ``NOTHING``."""
    if before is NOTHING:
        return f"{named(place)} was added: {shown(after)}"
    if after is NOTHING:
        return f"{named(place)} is gone; it was {shown(before)}"
    return f"{named(place)} was {shown(before)}, is {shown(after)}"


def _software(record: Record) -> Iterator[Finding]:
    present = software()
    for name, before in record.versions.items():
        if present.get(name) != before:
            yield _deviation("software", f"{name} was {before}, is {present.get(name, 'no longer used')}")


def _plugins(store: Store, record: Record) -> Iterator[Finding]:
    """Plug-ins that are not what they were, or that a record of an earlier version does not store."""
    for difference in plugin_differences(record.plugins or (), plugins_needed(store)):
        yield _deviation("plug-ins", difference)


def _policies(store: Store, record: Record) -> Iterator[Finding]:
    present = {(each.environment, each.policy): each for each in policy_files(store)}
    for before in record.policies:
        after = present.get((before.environment, before.policy))
        if after is not None and after != before:
            yield _deviation(f"policy {before.policy}", f"of {before.environment} {_replaced(before, after)}")


def _replaced(before: PolicyFile, after: PolicyFile) -> str:
    if before.source != after.source:
        return f"was {before.source}, is {after.source}"
    return f"is another: the checksum of {after.source} is not the one that was frozen"


# People and tests


def _people(store: Store, record: Record) -> Iterator[Finding]:
    """Who was excluded, withdrew or was deleted, and how many have completed the study.

    These are people, or simulated participants where a study has no others.
    """
    everyone, deleted = store.participants(), store.tombstones()
    simulated = all(each.simulated for each in [*everyone, *deleted])
    own = [each for each in everyone if each.simulated is simulated]
    for participant in own:
        if participant.state == "withdrawn":
            yield _deviation(participant.pseudonym, "withdrew and enters no test")
        elif participant.state == "excluded":
            yield _deviation(participant.pseudonym, "was excluded by the inclusion questions")
    for gone in deleted:
        if gone.simulated is simulated:
            yield _deviation(pseudonym_of(gone.number), "was deleted with all data")
    completed = sum(each.state == "completed" for each in own)
    planned = record.parsed().participants
    if completed and completed != planned:
        have = "has" if completed == 1 else "have"
        yield _deviation("participants", f"{completed} {have} completed the study, {planned} were planned")


def _tests(record: Record, offered: Offered, besides: Offered) -> Iterator[Finding]:
    """Tests that the report has and the plan does not name, and the other way round."""
    plan = record.parsed()
    for test, measures in offered.items():
        unplanned = [measure for measure in measures if plan.label(test, measure) == NOT_PLANNED]
        if unplanned:
            what = f"has a test that the plan does not name: {test} ({'; '.join(unplanned)})"
            yield _deviation("the report", what)
    for hypothesis in plan.hypotheses:
        for test in hypothesis.tests:
            done = {*offered.get(test, ()), *besides.get(test, ())}
            if not done & set(hypothesis.measures):
                yield _deviation("the report", f"has no test any more for {hypothesis.id}: {test}")


def _deviation(where: str, what: str) -> Finding:
    return Finding(where, what, wrong=False)
