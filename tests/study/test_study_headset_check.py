"""The design enables the headset check; results are stored with the session."""

import csv
from pathlib import Path

import msgspec
import pytest

from avrgym.analysis.study_analysis import analyse_study
from avrgym.recording.configuration import HeadsetCheck, TrackingQuality
from avrgym.study.design.design import parse_design, read_default_design_text
from avrgym.study.sessions.study_visit import StudyVisit, plan_session
from avrgym.study.storage.sessions import store_headset_check
from avrgym.study.storage.store import StudyStore
from avrgym.vr.latency import LATENCY_STAGES
from avrgym.vr.session import events
from helpers.studies.known_results import enrol_included, write_without_figures
from helpers.studies.small_studies import make_study

LINE = "headset_check = true\n"
CHECK = HeadsetCheck(
    device="Browser of the headset",
    emulated=False,
    profiles=["some-controller"],
    display_hz=72.0,
    duration_s=60.0,
    num_frames=4320,
    frame_rate_hz=71.9,
    dropped_share=0.002,
    latency_ms={stage: {"p50": 31.0, "p95": 44.0, "p99": 50.0} for stage in ("total_ms", *LATENCY_STAGES)},
    head=TrackingQuality("headset", 1.0, 0.31),
    left=TrackingQuality("controller", 1.0, 0.52, 0.61),
    right=TrackingQuality("controller", 1.0, 0.48, 0.63),
    vibration_felt=True,
    sound_heard=True,
)


def test_default_of_the_headset_check() -> None:
    assert parse_design(read_default_design_text()).headset_check
    assert not parse_design(read_default_design_text().replace(LINE, "")).headset_check


@pytest.mark.parametrize(
    ("design", "simulated", "asked", "checks"),
    [
        ("true", False, False, True),
        ("true", True, False, False),
        ("true", True, True, False),
        ("false", False, False, False),
        ("false", False, True, True),
    ],
)
def test_design_or_server_selects_the_headset_check(
    tmp_path: Path, design: str, simulated: bool, asked: bool, checks: bool
) -> None:
    with StudyStore(make_study(tmp_path / "study", headset_check=design)) as store:
        plan = plan_session(store, enrol_included(store, simulated=simulated), headset_check=asked)
    assert (plan.headset_check is not None) is checks


@pytest.mark.slow
def test_check_is_stored_with_its_session(tmp_path: Path) -> None:
    folder = make_study(tmp_path / "study")
    with StudyStore(folder) as store:
        unchecked, pseudonym = enrol_included(store), enrol_included(store, simulated=False)
        for who in (unchecked, pseudonym):
            with StudyVisit(store, who) as visit:
                if who == pseudonym:
                    shaky = msgspec.structs.replace(CHECK, head=TrackingQuality("headset", 1.0, 4.0))
                    for check in (shaky, CHECK):
                        visit._observer()(events.HeadsetChecked(1.0, check))
        assert [session.latest_headset_check for session in store.read_sessions(unchecked)] == [None]
        assert [session.latest_headset_check for session in store.read_sessions(pseudonym)] == [CHECK]
        told = [each.detail for each in store.read_events() if each.name == "headset checked"]
        assert "No-go. Your head jitters at rest by 4.0 mm" in told[0]
        assert told[1].startswith(
            "Go: the headset is ready. 72 frames per second (display: 72); 0.2 % dropped"
        )
        assert not store.database.find_integrity_errors()
        write_without_figures(analyse_study(store), store.folder, tmp_path / "out")
    page = (tmp_path / "out/report/index.html").read_text()
    methods = page[page.index('id="methods"') :]
    for shown in ("Checks of the headset", "some-controller", "0.2 %", "0.52 (controller)", "sub-002"):
        assert shown in methods
    pack = (tmp_path / "out/reporting/methods.md").read_text()
    assert "checked at the beginning of 1 session and found ready in 1 (medians: 72 frames a second" in pack
    assert (tmp_path / "out/tables/headset_checks.csv").is_file()


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(
    ("stop", "after_s", "row", "shown"),
    [
        ("palm", 2.5, ["palm", "true", "2.5"], ">palm</td>"),
        ("none", None, ["", "false", ""], ">not tried</td>"),
        (None, None, ["", "", ""], ">not asked</td>"),
    ],
)
def test_tested_stop_is_in_table_and_report(
    tmp_path: Path, stop: str | None, after_s: float | None, row: list[str], shown: str
) -> None:
    """A check of an earlier version has neither a stop nor its time."""
    with StudyStore(make_study(tmp_path / "study")) as store:
        with StudyVisit(store, enrol_included(store, simulated=False)) as visit:
            check = msgspec.structs.replace(CHECK, stop_method=stop, stop_delay_s=after_s)
            visit._observer()(events.HeadsetChecked(1.0, check))
        write_without_figures(analyse_study(store), store.folder, tmp_path / "out")
    with open(tmp_path / "out/tables/headset_checks.csv", encoding="utf-8-sig", newline="") as file:
        (read,) = csv.DictReader(file)
    assert [read[name] for name in ("stop_with", "stop_worked", "stop_after_s")] == row
    page = (tmp_path / "out/report/index.html").read_text()
    assert shown in page[page.index("Checks of the headset") :]


def test_report_without_headset_checks(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path / "study")) as store:
        with StudyVisit(store, enrol_included(store)):
            pass
        write_without_figures(analyse_study(store), store.folder, tmp_path / "out")
    assert "Checks of the headset" not in (tmp_path / "out/report/index.html").read_text()
    assert not (tmp_path / "out/tables/headset_checks.csv").exists()


def test_check_after_the_session_is_rejected(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path / "study")) as store:
        with StudyVisit(store, enrol_included(store)) as visit:
            pass
        with pytest.raises(Exception, match="allowed: an open session"):
            store_headset_check(store, visit.stored_session.id, CHECK)
