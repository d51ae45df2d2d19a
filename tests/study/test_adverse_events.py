"""Adverse events: published grades, follow-ups, exports, and separation from safety events of the robot."""

import csv
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from avrgym.analysis.adverse_events import describe_adverse_events
from avrgym.analysis.study_analysis import analyse_study
from avrgym.cli import app
from avrgym.study.export import EXPORT_FORMATS, FORMATS_WITH_EVENTS, export_study
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.event_tables import ExportOptions
from avrgym.study.people.adverse_events import (
    ADVERSE_EVENT_RATING_SCALES,
    AdverseEventDetails,
    group_reports_by_event,
    list_safety_events,
    record_adverse_event,
)
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import add_note, withdraw_participant
from avrgym.study.storage.attempts import begin_attempt, end_incomplete_attempt
from avrgym.study.storage.sessions import open_session, record_session_event
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import write_without_figures
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study

SECRET = "Grace-Unverwechselbar"
DIZZY = AdverseEventDetails(
    began_at="2026-11-27T14:30:00+01:00",
    description=f"{SECRET} felt dizzy",
    severity="mild",
    seriousness="not serious",
    relatedness="probable",
    outcome="recovering",
    trial=2,
    action="break",
)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    """Two people and a simulated participant; the first person has three completed trials."""
    with StudyStore(small_study(tmp_path / "study")) as opened:
        run_participant(opened, enrol_with_consent(opened, simulated=False), trials=3, simulated=False)
        enrol_with_consent(opened, simulated=False)
        enrol_with_consent(opened)
        yield opened


def changed(**changes: Any) -> AdverseEventDetails:
    return AdverseEventDetails(**{name: getattr(DIZZY, name) for name in DIZZY.__struct_fields__} | changes)


def read(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file, delimiter="\t" if path.suffix == ".tsv" else ","))


def test_follow_ups_keep_earlier_reports(store: StudyStore) -> None:
    number = record_adverse_event(store, "sub-001", DIZZY, recorded_by="kim")
    before = store.read_adverse_event_reports("sub-001")
    record_adverse_event(store, "sub-001", changed(outcome="recovered"), follows=number)
    second = record_adverse_event(store, "sub-001", changed(trial=None))
    record_adverse_event(
        store, "sub-001", changed(outcome="recovered", severity="severe"), follows=number + 1
    )
    assert store.read_adverse_event_reports("sub-001")[:1] == before
    assert before[0].began_at == "2026-11-27T13:30:00+00:00"
    assert before[0].recorded_by == "kim"
    dizzy, other = group_reports_by_event(store.read_adverse_event_reports("sub-001"))
    assert [report.outcome for report in dizzy.reports] == ["recovering", "recovered", "recovered"]
    assert (dizzy.event_number, dizzy.latest_report.severity) == (number, "severe")
    assert (other.event_number, other.latest_report.trial) == (second, None)
    assert store.database.find_integrity_errors() == []
    names = [event.name for event in store.read_events() if "adverse" in event.name]
    assert names == [
        f"adverse event {what}" for what in ("recorded", "followed up", "recorded", "followed up")
    ]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("scale", ADVERSE_EVENT_RATING_SCALES)
def test_grades_outside_the_scales_are_rejected(store: StudyStore, scale: str) -> None:
    for grade in ADVERSE_EVENT_RATING_SCALES[scale]:
        record_adverse_event(store, "sub-001", changed(**{scale: grade}))
    with pytest.raises(
        StudyError, match=f"unknown {scale} 'awful'; allowed: {ADVERSE_EVENT_RATING_SCALES[scale][0]}"
    ):
        record_adverse_event(store, "sub-001", changed(**{scale: "awful"}))
    assert len(store.read_adverse_event_reports("sub-001")) == len(ADVERSE_EVENT_RATING_SCALES[scale])


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(
    ("pseudonym", "changes", "follows", "words"),
    [
        ("sub-003", {}, None, "sub-003 is a simulated participant; allowed: a person"),
        ("sub-004", {}, None, "there is no sub-004"),
        ("sub-001", {"trial": 9}, None, "there is no trial 9 of sub-001"),
        ("sub-002", {}, 1, "there is no adverse event 1 of sub-002"),
        ("sub-001", {"description": ""}, None, "the description is empty"),
        ("sub-001", {"action": "x" * 201}, None, "the action is 201 characters long; allowed: at most 200"),
        (
            "sub-001",
            {"began_at": "2026-11-27T14:30:00"},
            None,
            "is not a time; allowed: ISO 8601 with a UTC offset",
        ),
        ("sub-001", {"began_at": "yesterday"}, None, "is not a time"),
        ("sub-001", {"began_at": "2126-11-27T14:30:00Z"}, None, "is in the future"),
    ],
)
def test_invalid_reports_are_rejected(
    store: StudyStore, pseudonym: str, changes: dict[str, Any], follows: int | None, words: str
) -> None:
    record_adverse_event(store, "sub-001", DIZZY)
    before = store.read_adverse_event_reports("sub-001")
    with pytest.raises(StudyError, match=words):
        record_adverse_event(store, pseudonym, changed(**changes), follows=follows)
    assert store.read_adverse_event_reports("sub-001") == before


def test_deletion_removes_reports_and_withdrawal_keeps_them(store: StudyStore) -> None:
    number = record_adverse_event(store, "sub-001", DIZZY)
    record_adverse_event(store, "sub-001", changed(outcome="recovered"), follows=number)
    withdraw_participant(store, "sub-001", "dizzy")
    assert len(store.read_adverse_event_reports("sub-001")) == 2
    record_adverse_event(store, "sub-002", DIZZY)
    delete_participant(store, "sub-001")
    assert store.read_adverse_event_reports("sub-001") == []
    assert len(store.read_adverse_event_reports("sub-002")) == 1
    assert store.database.find_integrity_errors() == []
    held = [path for path in store.folder.rglob("*") if path.is_file()]
    assert sum(path.read_bytes().count(SECRET.encode()) for path in held) == 1


def test_safety_events_are_separate_from_adverse_events(store: StudyStore) -> None:
    session = open_session(store, "sub-002")
    attempt = begin_attempt(store, session.id, 1)
    record_session_event(store, session.id, "stopped", "by participant", attempt.id)
    record_session_event(store, session.id, "continued", "", attempt.id)
    end_incomplete_attempt(store, attempt.id, "stopped")
    (stop,) = list_safety_events(store, "sub-002")
    assert (stop.trial, stop.name, stop.detail) == (1, "stopped", "by participant")
    assert list(list_safety_events(store, "sub-001")) == []
    assert store.read_adverse_event_reports("sub-002") == []


# Exports


@pytest.fixture
def told(store: StudyStore) -> StudyStore:
    """A study with a name in each kind of free text."""
    number = record_adverse_event(store, "sub-001", DIZZY, recorded_by=SECRET)
    record_adverse_event(store, "sub-001", changed(action=f"{SECRET} rested"), follows=number)
    add_note(store, "sub-001", f"{SECRET} laughed")
    record_session_event(store, store.read_sessions("sub-001")[0].id, "connection lost")
    withdraw_participant(store, "sub-001", f"{SECRET} was tired")
    return store


@pytest.mark.parametrize("data_format", FORMATS_WITH_EVENTS)
def test_free_text_is_exported_only_on_request(told: StudyStore, tmp_path: Path, data_format: str) -> None:
    folder, suffix = ("", ".csv") if data_format == "csv" else ("sourcedata", ".tsv")
    export_study(told, data_format, tmp_path / "without")
    export_study(told, data_format, tmp_path / "with", extras=ExportOptions(include_free_text=True))
    files = [path.read_bytes() for path in (tmp_path / "without").rglob("*") if path.is_file()]
    assert not any(SECRET.encode() in data for data in files)
    without, with_all = tmp_path / "without" / folder, tmp_path / "with" / folder
    assert not (without / f"notes{suffix}").exists()
    assert [row["text"] for row in read(with_all / f"notes{suffix}")] == [f"{SECRET} laughed"]
    events = read(with_all / f"events{suffix}")
    assert SECRET in next(row["detail"] for row in events if row["name"] == "participant withdrawn")
    assert "connection lost" in {row["name"] for row in read(without / f"events{suffix}")}
    assert len(events) == len(read(without / f"events{suffix}"))
    for place, secret in ((without, False), (with_all, True)):
        first, second = read(place / f"adverse_events{suffix}")
        assert (first["event"], first["report"], second["report"]) == ("1", "1", "2")
        assert (first["severity"], first["position"], first["task"]) == ("mild", "2", "Feeding")
        assert (SECRET in second["action"], SECRET in first["recorded_by"]) == (secret, secret)


@pytest.mark.parametrize("data_format", sorted(set(EXPORT_FORMATS) - set(FORMATS_WITH_EVENTS)))
def test_formats_without_free_text_reject_the_option(
    store: StudyStore, tmp_path: Path, data_format: str
) -> None:
    with pytest.raises(StudyError, match="cannot contain free text and health data; allowed: csv, bids"):
        export_study(store, data_format, tmp_path / "out", extras=ExportOptions(include_free_text=True))


# Commands


def run(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["study", *map(str, words)])
    assert result.exit_code == code, result.output
    return result.output


def test_command_records_follows_up_and_lists_events(store: StudyStore, tmp_path: Path) -> None:
    folder = store.folder
    assert "No adverse events were recorded." in run("adverse-events", folder)
    graded = ("--severity", "mild", "--seriousness", "not serious", "--relatedness", "possible")
    record = ("record-adverse-event", folder, "sub-001", "--description", "neck pain", *graded)
    assert "unknown severity ''" in run("record-adverse-event", folder, "sub-001", code=1)
    run(*record, "--outcome", "recovering", "--trial", 2, "--by", "kim")
    run("record-adverse-event", folder, "sub-001", "--follow-up", 1, "--outcome", "recovered", "--by", "alex")
    assert "has no adverse event 7" in run(
        "record-adverse-event", folder, "sub-001", "--follow-up", 7, code=1
    )
    first, second = store.read_adverse_event_reports("sub-001")
    assert (second.description, second.trial, second.began_at) == ("neck pain", first.trial, first.began_at)
    assert (first.recorded_by, second.recorded_by) == ("kim", "alex")
    shown = run("adverse-events", folder, "--json", tmp_path / "a.json", "--out", tmp_path / "board")
    assert "1 adverse events" in shown
    assert "neck pain" in shown
    assert [row["outcome"] for row in json.loads((tmp_path / "a.json").read_text())["adverse_events"]] == [
        "recovering",
        "recovered",
    ]
    assert len(read(tmp_path / "board" / "adverse_events.tsv")) == 2
    described = json.loads((tmp_path / "board" / "adverse_events.json").read_text())
    assert list(described) == list(COLUMNS_BY_TABLE["adverse_events"])
    assert (tmp_path / "board").stat().st_mode & 0o077 == 0


# The report


@pytest.mark.slow
def test_report_counts_events_by_condition(store: StudyStore, tmp_path: Path) -> None:
    write_without_figures(analyse_study(store), store.folder, tmp_path / "none")
    page = (tmp_path / "none" / "report" / "index.html").read_text()
    assert "No adverse events were recorded." in page
    assert read(tmp_path / "none" / "tables" / "adverse_events.csv") == []
    number = record_adverse_event(store, "sub-001", changed(severity="severe", seriousness="hospitalisation"))
    record_adverse_event(store, "sub-001", changed(severity="moderate"), follows=number)
    record_adverse_event(store, "sub-001", changed(trial=1, relatedness="unlikely"))
    record_adverse_event(store, "sub-002", changed(trial=None))
    withdraw_participant(store, "sub-001")
    analysis = analyse_study(store)
    assert describe_adverse_events(analysis) == (
        "3 adverse events in 2 of 2 people; 0 serious, 2 possibly, probably or definitely related to the study."
    )
    write_without_figures(analysis, store.folder, tmp_path / "some")
    page = (tmp_path / "some" / "report" / "index.html").read_text()
    assert describe_adverse_events(analysis) in (tmp_path / "some" / "reporting" / "methods.md").read_text()
    assert SECRET not in page
    rows = {row[0]: row[1:] for row in rows_under(page, "Adverse events by condition")}
    trial = store.read_trials("sub-001")[1]
    robot = "PR2" if "PR2" in trial.environment else "Jaco"
    assert rows[f"{robot} {trial.policy}"] == ["1", "1", "1", "0", "1", "0", "0", "0", "0", "1"]
    assert rows["practice"] == ["1", "1", "1", "1", "0", "0", "0", "0", "0", "0"]
    assert rows["outside trials"] == ["–", "1", "1", "1", "0", "0", "0", "0", "0", "1"]
    assert len(read(tmp_path / "some" / "tables" / "adverse_events.csv")) == 4


def rows_under(page: str, caption: str) -> list[list[str]]:
    """The cells of the table with this beginning of a caption."""
    whole = next(part for part in page.split("<caption>")[1:] if part.startswith(caption))
    body = whole.split("<tbody>")[1].split("</tbody>")[0]
    return [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in body.split("</tr>")[:-1]]
