"""A study stores its plug-ins, and a check lists those that differ between trials."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace as Namespace
from typing import Any, cast

import msgspec
import pytest
from typer.testing import CliRunner

from avrgym.analysis.publication.methods import _plugins
from avrgym.analysis.reading.study_data import read_study_data
from avrgym.cli.main import app
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.plugin_checks import check_plugins
from avrgym.study.plan.frozen_plan import FrozenAnalysisPlan, freeze_analysis_plan, read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import find_deviations
from avrgym.study.plan.plan_template import write_plan_template
from avrgym.study.sessions.study_visit import StudyVisit
from avrgym.study.storage.store import StudyStore
from avrgym.system import plugins
from avrgym.system.used_plugins import UsedPlugin
from avrgym.tasks.registry import find_plugins
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant
from helpers.system.fake_plugins import change, register

ENVIRONMENT = "avrgym/FeedingJaco-v1"


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    return register(monkeypatch, tmp_path / "lab", plugins.ROBOT_ENTRY_POINT_GROUP, "Jaco")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]')


def findings(store: StudyStore) -> list[Finding]:
    return list(check_plugins(store))


def checked(folder: Path) -> tuple[int, str]:
    ran = CliRunner().invoke(app, ["study", "check", str(folder)])
    return ran.exit_code, ran.output


def test_changed_robot_plugin_is_reported(robot: Path, folder: Path) -> None:
    with StudyStore(folder) as store:
        first, second = enrol_with_consent(store), enrol_with_consent(store)
        run_participant(store, first, 2)
        assert findings(store) == []
        before = find_plugins(ENVIRONMENT)[0]
        change(robot)
        (note,) = findings(store)
        assert (note.where, note.is_error) == ("robot Jaco", False)
        assert (
            note.message
            == f"is installed as {find_plugins(ENVIRONMENT)[0]}, which no trial used; trials used {before}"
        )
        run_participant(store, first, 1)
        run_participant(store, second, 1)
        (wrong,) = findings(store)
        assert wrong.is_error
        assert wrong.message == (
            f"was not the same in all trials: {before} in sub-001 trials 1 2; "
            f"{find_plugins(ENVIRONMENT)[0]} in sub-001 trial 3, sub-002 trial 1"
        )
        (problem,) = (each for each in read_study_data(store).problems if each.where == "robot Jaco")
        assert (problem.what, problem.simulated) == (wrong.message, True)
    code, said = checked(folder)
    assert code == 1
    assert "error robot Jaco: was not the same in all trials" in " ".join(said.split())


def test_dry_run_before_a_change_does_not_concern_people(robot: Path, folder: Path) -> None:
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), 1)
        change(robot)
        run_participant(store, enrol_with_consent(store, simulated=False), 1, simulated=False)
        assert [each for each in findings(store) if each.is_error] == []


def test_study_without_plugins_has_no_findings(folder: Path) -> None:
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), 1)
        assert findings(store) == []
        assert [each for each in store.read_events() if each.name == "plug-in used"] == []


def test_sessions_store_their_plugins(robot: Path, folder: Path) -> None:
    with StudyStore(folder) as store:
        with StudyVisit(store, enrol_with_consent(store)):
            pass
        (event,) = (each for each in store.read_events() if each.name == "plug-in used")
        assert event.session is not None
        assert (msgspec.json.decode(event.detail, type=UsedPlugin),) == find_plugins(ENVIRONMENT)


def freeze_with_template(store: StudyStore) -> None:
    from avrgym.analysis.plan import list_available_tests, suggest_hypotheses

    offered = list_available_tests(store.design)
    write_plan_template(store.folder, store.design, offered, suggest_hypotheses(store.design))
    freeze_analysis_plan(store, offered)


def deviating(
    store: StudyStore, change: Callable[[FrozenAnalysisPlan], FrozenAnalysisPlan] = lambda record: record
) -> list[str]:
    frozen = read_frozen_plan_evidence(store)
    assert frozen is not None
    assert frozen.frozen_plan is not None
    changed = replace(frozen, frozen_plan=change(frozen.frozen_plan))
    return [each.message for each in find_deviations(store, changed, {}) if each.where == "plug-ins"]


def test_changed_plugin_is_a_deviation(robot: Path, folder: Path) -> None:
    with StudyStore(folder) as store:
        freeze_with_template(store)
        assert deviating(store) == []
        before = find_plugins(ENVIRONMENT)[0]
        change(robot)
        assert deviating(store) == [f"robot Jaco was {before}, is {find_plugins(ENVIRONMENT)[0]}"]


def test_plan_of_an_earlier_version_has_no_plugins(robot: Path, folder: Path) -> None:
    def earlier(record: FrozenAnalysisPlan) -> FrozenAnalysisPlan:
        values = msgspec.to_builtins(record)
        del values["plugins"]
        return msgspec.convert(values, FrozenAnalysisPlan)

    with StudyStore(folder) as store:
        freeze_with_template(store)
        assert deviating(store, earlier) == [f"robot Jaco was not stored, is {find_plugins(ENVIRONMENT)[0]}"]


def test_methods_section_lists_plugins(robot: Path, folder: Path) -> None:
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store), 2)
        said = list(
            _plugins(
                cast(Any, Namespace(study_data=read_study_data(store))),
                cast(Any, Namespace(is_simulated=True)),
            )
        )
    then = find_plugins(ENVIRONMENT)[0]
    assert said == [f"Plug-ins, with the hash of their files: robot Jaco: {then}, 2 trials."]
