"""In what a study deviates from its frozen plan, in words."""

from collections.abc import Iterator, Sequence
from types import MappingProxyType

import tomlkit

from avrgym.study.checking.finding import Finding, LeftOut
from avrgym.study.checking.interim_looks import check_interim_looks
from avrgym.study.checking.policy_files import PolicyFile, called, policies_used, policy_files
from avrgym.study.checking.preflight import plugins_needed
from avrgym.study.checking.repeat_checks import check_repeats
from avrgym.study.plan.design_deviations import changed_file, design_deviations, deviation
from avrgym.study.plan.freezing import FROZEN, Record, software
from avrgym.study.plan.origin import Frozen
from avrgym.study.plan.plan import FILE, NOT_PLANNED, Offered
from avrgym.study.storage.rows import pseudonym_of
from avrgym.study.storage.states import UNKNOWN
from avrgym.study.storage.store import Store
from avrgym.study.storage.uses import listed
from avrgym.system.used_plugins import differences as plugin_differences


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
        *design_deviations(store, frozen.record),
        *changed_file(store, frozen.record, FILE, frozen.record.plan),
        *_software(frozen.record),
        *_policies(store, frozen.record),
        *_plugins(store, frozen.record),
        *_people(store, frozen.record),
        *check_interim_looks(store, frozen.record.parsed().participants),
        *check_repeats(store, tomlkit.parse(frozen.record.design).unwrap().get("max_repeats")),
        *left_out,
        *_tests(frozen.record, offered, besides),
    ]


# Software and policies


def _software(record: Record) -> Iterator[Finding]:
    present = software()
    for name, before in record.versions.items():
        if present.get(name) != before:
            yield deviation("software", f"{name} was {before}, is {present.get(name, 'no longer used')}")


def _plugins(store: Store, record: Record) -> Iterator[Finding]:
    """Plug-ins that are not what they were, or that a record of an earlier version does not store."""
    for difference in plugin_differences(record.plugins or (), plugins_needed(store)):
        yield deviation("plug-ins", difference)


def _policies(store: Store, record: Record) -> Iterator[Finding]:
    present = {(each.environment, each.policy): each for each in policy_files(store)}
    used = policies_used(store)
    for before in record.policies:
        key = before.environment, before.policy
        after = present.get(key)
        if after is not None and after != before:
            yield deviation(f"policy {before.policy}", f"of {before.environment} {_replaced(before, after)}")
        for other in used.get(key, []):
            if other.file != before:
                what = f"of {before.environment} was {called(other.file)} for {listed(other.uses)}"
                yield deviation(f"policy {before.policy}", what)


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
            yield deviation(participant.pseudonym, "withdrew and enters no test")
        elif participant.state == UNKNOWN:
            what = (
                "enters no test: whether they consented or withdrew is unknown since the database was rebuilt"
            )
            yield deviation(participant.pseudonym, what)
        elif participant.state == "excluded":
            yield deviation(participant.pseudonym, "was excluded by the inclusion questions")
    for gone in deleted:
        if gone.simulated is simulated:
            yield deviation(pseudonym_of(gone.number), "was deleted with all data")
    completed = sum(each.state == "completed" for each in own)
    planned = record.parsed().participants
    if completed and completed != planned:
        have = "has" if completed == 1 else "have"
        yield deviation("participants", f"{completed} {have} completed the study, {planned} were planned")


def _tests(record: Record, offered: Offered, besides: Offered) -> Iterator[Finding]:
    """Tests that the report has and the plan does not name, and the other way round."""
    plan = record.parsed()
    for test, measures in offered.items():
        unplanned = [measure for measure in measures if plan.label(test, measure) == NOT_PLANNED]
        if unplanned:
            what = f"has a test that the plan does not name: {test} ({'; '.join(unplanned)})"
            yield deviation("the report", what)
    for hypothesis in plan.hypotheses:
        for test in hypothesis.tests:
            done = {*offered.get(test, ()), *besides.get(test, ())}
            if not done & set(hypothesis.measures):
                yield deviation("the report", f"has no test any more for {hypothesis.id}: {test}")
