"""Find deviations of a study from its frozen plan: design, texts, software, policies, participants and tests."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import tomlkit

from avrgym.study.checking.design_checks import (
    ADMISSION_FIELDS,
    CONSENT_FIELD,
    find_admission_differences,
    find_design_differences,
)
from avrgym.study.checking.finding import ExcludedTrialFinding, Finding
from avrgym.study.checking.interim_looks import check_interim_looks
from avrgym.study.checking.policy_files import (
    PolicyFile,
    find_policy_files,
    find_used_policies,
    format_policy_file,
)
from avrgym.study.checking.preflight import find_needed_plugins
from avrgym.study.checking.repeat_checks import check_repeats
from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.design.design import Design, DesignError, parse_design
from avrgym.study.design.design_comparison import (
    FIELDS_NOT_COMPARED,
    MISSING_VALUE,
    DesignTexts,
    find_value_differences,
    format_key_path,
    format_value,
    make_comparable_values,
    read_design_texts,
)
from avrgym.study.design.languages import find_text_files
from avrgym.study.plan.analysis_plan import NOT_PLANNED_STATUS, PLAN_FILE, AvailableTests
from avrgym.study.plan.frozen_plan import (
    FROZEN_PLAN_FILE,
    FrozenAnalysisPlan,
    FrozenPlanEvidence,
    compute_sha256,
    read_software_versions,
)
from avrgym.study.storage.database_rows import format_pseudonym
from avrgym.study.storage.session_designs import describe_trials, read_session_designs
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import make_bom_variants
from avrgym.system.toml_lines import ValuePath
from avrgym.system.used_plugins import describe_plugin_differences as plugin_differences
from avrgym.texts.interface_texts import InvalidTextsError

ValueChange = tuple[ValuePath, Any, Any]
"""Key path of a value, its frozen value and its current value; a missing value is ``MISSING_VALUE``."""


def find_design_deviations(store: StudyStore, record: FrozenAnalysisPlan) -> Iterator[Finding]:
    """Yields findings about differences between the frozen plan and the design or the texts for participants.

    Differences in sessions are included even if the current files match the plan.
    """
    frozen = read_frozen_design(record)
    differing = _session_values(store, *frozen) if frozen else {}
    for name, before in {DESIGN: record.design, **(record.texts or {})}.items():
        fault, changes = _compare(store, record, name, before, frozen[0] if frozen else None)
        if fault:
            yield make_deviation_finding(name, fault)
        for change in changes:
            _, participants = differing.pop((name, change[0], format_value(change[2])), (None, ""))
            yield make_deviation_finding(
                name, describe_change(*change) + (f", for {participants}" if participants else "")
            )
    for (name, place, value), (before, participants) in differing.items():
        yield make_deviation_finding(
            name, f"{format_key_path(place)} was {before} in the plan and {value} for {participants}"
        )
    for name in find_text_files(store.design, store.folder):
        if record.texts is not None and name not in record.texts:
            yield make_deviation_finding(name, "was added")


def _session_values(
    store: StudyStore, design: Design, wordings: DesignTexts | None
) -> dict[tuple[str, ValuePath, str], tuple[str, str]]:
    """Returns the values of sessions and admissions that differ from the frozen design.

    Key: file, key path and different value. Value: frozen value, and the participants with the different value.
    """
    sessions = read_session_designs(store)
    found = {
        (each.file_name, each.key_path, format_value(each.session_value)): (
            format_value(each.current_value),
            describe_trials(each.session_designs, sessions),
        )
        for each in find_design_differences(design, wordings, sessions)
    }
    admitted = find_admission_differences(store, design, (CONSENT_FIELD, *ADMISSION_FIELDS))
    return found | {
        (DESIGN, place, format_value(there)): (format_value(here), ", ".join(people))
        for (place, here, there), people in admitted
    }


def find_file_deviations(
    store: StudyStore, record: FrozenAnalysisPlan, name: str, before: str
) -> Iterator[Finding]:
    """Yields findings about differences between a file and its frozen text (``before``)."""
    fault, changes = _compare(store, record, name, before, None)
    if fault:
        yield make_deviation_finding(name, fault)
    yield from (make_deviation_finding(name, describe_change(*change)) for change in changes)


def read_frozen_design(record: FrozenAnalysisPlan) -> tuple[Design, DesignTexts | None] | None:
    """Returns the design and texts of a frozen plan; ``None`` if this version cannot read them."""
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name, text in (record.texts or {}).items():
            if not (folder / name).resolve().is_relative_to(folder.resolve()):
                return None
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        try:
            design = parse_design(record.design, FROZEN_PLAN_FILE, folder)
            return design, None if record.texts is None else read_design_texts(design, folder)
        except (DesignError, InvalidTextsError):
            return None


def _compare(
    store: StudyStore, record: FrozenAnalysisPlan, name: str, before: str, frozen: Design | None
) -> tuple[str, list[ValueChange]]:
    """Returns the differences between a file and its frozen text: a message about the file (or ""), and all changes."""
    path = store.folder / name
    if not path.is_file():
        return "is missing", []
    data = path.read_bytes()
    if record.sha256[name] in map(compute_sha256, make_bom_variants(data)):
        return "", []
    try:
        after = tomlkit.parse(make_bom_variants(data)[0].decode()).unwrap()
    except ValueError:
        return "was changed and cannot be read", []
    values = tomlkit.parse(before).unwrap()
    if values == after:
        return "was changed only in comments or layout", []
    if name == DESIGN and frozen is not None:
        return "", list(
            find_value_differences(make_comparable_values(frozen), make_comparable_values(store.design))
        )
    return "", list(find_value_differences(_shared(values), _shared(after)))


def _shared(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns the file's fields that are compared: all except ``FIELDS_NOT_COMPARED``."""
    return {name: value for name, value in values.items() if name not in FIELDS_NOT_COMPARED}


def describe_change(place: ValuePath, before: Any, after: Any) -> str:
    """Returns a difference as text; a missing value is ``MISSING_VALUE``."""
    if before is MISSING_VALUE:
        return f"{format_key_path(place)} was added: {format_value(after)}"
    if after is MISSING_VALUE:
        return f"{format_key_path(place)} was removed; it was {format_value(before)}"
    return f"{format_key_path(place)} was {format_value(before)}, is {format_value(after)}"


def make_deviation_finding(where: str, message: str) -> Finding:
    """Returns the finding about a deviation from the plan. The finding is a note, not an error."""
    return Finding(where, message, is_error=False)


def find_deviations(
    store: StudyStore,
    frozen: FrozenPlanEvidence,
    available_tests: AvailableTests,
    left_out: Sequence[ExcludedTrialFinding] = (),
    optional_tests: AvailableTests = MappingProxyType({}),
) -> list[Finding]:
    """Returns findings about all differences between a study and its frozen plan.

    Args:
        store: the study.
        frozen: the frozen plan.
        available_tests: the tests of the current analysis.
        left_out: findings about trials that the analysis excludes.
        optional_tests: tests that the plan may contain. They are exploratory if it does not.
    """
    found = [Finding(FROZEN_PLAN_FILE, fault) for fault in frozen.error_messages]
    if frozen.frozen_plan is None:
        return found
    return [
        *found,
        *find_design_deviations(store, frozen.frozen_plan),
        *find_file_deviations(store, frozen.frozen_plan, PLAN_FILE, frozen.frozen_plan.plan),
        *_software(frozen.frozen_plan),
        *_policies(store, frozen.frozen_plan),
        *_plugins(store, frozen.frozen_plan),
        *_people(store, frozen.frozen_plan),
        *check_interim_looks(store, frozen.frozen_plan.parse_plan().participants),
        *check_repeats(store, tomlkit.parse(frozen.frozen_plan.design).unwrap().get("max_repeats")),
        *left_out,
        *_tests(frozen.frozen_plan, available_tests, optional_tests),
    ]


# Software and policies


def _software(record: FrozenAnalysisPlan) -> Iterator[Finding]:
    present = read_software_versions()
    for name, before in record.versions.items():
        if present.get(name) != before:
            yield make_deviation_finding(
                "software", f"{name} was {before}, is {present.get(name, 'no longer used')}"
            )


def _plugins(store: StudyStore, record: FrozenAnalysisPlan) -> Iterator[Finding]:
    """Yields findings about plug-ins that differ from the frozen record."""
    for difference in plugin_differences(record.plugins or (), find_needed_plugins(store)):
        yield make_deviation_finding("plug-ins", difference)


def _policies(store: StudyStore, record: FrozenAnalysisPlan) -> Iterator[Finding]:
    present = {(each.environment, each.policy): each for each in find_policy_files(store)}
    used = find_used_policies(store)
    for before in record.policies:
        key = before.environment, before.policy
        after = present.get(key)
        if after is not None and after != before:
            yield make_deviation_finding(
                f"policy {before.policy}", f"of {before.environment} {_replaced(before, after)}"
            )
        for other in used.get(key, []):
            if other.policy_file != before:
                file, trials = format_policy_file(other.policy_file), describe_trials(other.session_designs)
                message = f"of {before.environment} was {file} for {trials}"
                yield make_deviation_finding(f"policy {before.policy}", message)


def _replaced(before: PolicyFile, after: PolicyFile) -> str:
    if before.source != after.source:
        return f"was {before.source}, is {after.source}"
    return f"was changed: the checksum of {after.source} differs from the frozen one"


# People and tests


def _people(store: StudyStore, record: FrozenAnalysisPlan) -> Iterator[Finding]:
    """Yields findings about excluded, withdrawn and deleted participants, and about the number of completed ones.

    Simulated participants are considered only in a study without people.
    """
    everyone, deleted = store.read_participants(), store.read_deleted_participants()
    simulated = all(each.simulated for each in [*everyone, *deleted])
    own = [each for each in everyone if each.simulated is simulated]
    for participant in own:
        if participant.state == "withdrawn":
            yield make_deviation_finding(participant.pseudonym, "withdrew and is excluded from all tests")
        elif participant.state == UNKNOWN_PARTICIPATION_STATE:
            message = (
                "is excluded from all tests: consent or withdrawal is unknown since the database was rebuilt"
            )
            yield make_deviation_finding(participant.pseudonym, message)
        elif participant.state == "excluded":
            yield make_deviation_finding(participant.pseudonym, "was excluded by the inclusion questions")
    for gone in deleted:
        if gone.simulated is simulated:
            yield make_deviation_finding(format_pseudonym(gone.number), "was deleted with all data")
    completed = sum(each.state == "completed" for each in own)
    planned = record.parse_plan().participants
    if completed and completed != planned:
        have = "has" if completed == 1 else "have"
        yield make_deviation_finding(
            "participants", f"{completed} {have} completed the study, {planned} were planned"
        )


def _tests(
    record: FrozenAnalysisPlan, available_tests: AvailableTests, optional_tests: AvailableTests
) -> Iterator[Finding]:
    """Yields findings about unplanned tests in the report, and about planned tests without a result."""
    plan = record.parse_plan()
    for test, measures in available_tests.items():
        unplanned = [
            measure for measure in measures if plan.find_test_status(test, measure) == NOT_PLANNED_STATUS
        ]
        if unplanned:
            message = f"contains a test that is not in the plan: {test} ({'; '.join(unplanned)})"
            yield make_deviation_finding("the report", message)
    for hypothesis in plan.hypotheses:
        for test in hypothesis.tests:
            done = {*available_tests.get(test, ()), *optional_tests.get(test, ())}
            if not done & set(hypothesis.measures):
                yield make_deviation_finding("the report", f"lacks a planned test of {hypothesis.id}: {test}")
