"""Retention: due data are listed, and only the command deletes them and stores an event."""

from collections.abc import Iterator
from datetime import date
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.study.checking.study_checks import check_retention_periods, check_study
from avrgym.study.dashboard.displayed_data import make_study_overview
from avrgym.study.design.design import DesignError, parse_design, read_design
from avrgym.study.design.retention import RetentionPeriods
from avrgym.study.people import retention
from avrgym.study.people.retention import delete_due_data, list_due_deletions, list_scheduled_deletions
from avrgym.study.storage import identity_file
from avrgym.study.storage.sessions import close_session, open_session
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study

END = date(2126, 6, 30)
PERIODS = 'ended_on = "2126-06-30"\nidentities_months = 6\nrecordings_years = 2\ndata_years = 10\n'


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two people with recordings, one of them with a name, and a simulated participant."""
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as store:
        for name in ("Ada Example", ""):
            run_participant(
                store, enrol_with_consent(store, simulated=False, name=name), trials=2, simulated=False
            )
        run_participant(store, enrol_with_consent(store), trials=1)
    return folder


@pytest.fixture
def store(folder: Path) -> Iterator[StudyStore]:
    state(folder, PERIODS)
    with StudyStore(folder) as opened:
        yield opened


def state(folder: Path, lines: str) -> None:
    """Write the ``[retention]`` table of a design."""
    path = folder / "study.toml"
    path.write_text(path.read_text().replace("[retention]\n", f"[retention]\n{lines}"))


def run(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["study", *map(str, words)])
    assert result.exit_code == code, result.output
    return result.output


def files(folder: Path) -> set[Path]:
    return {path for path in folder.rglob("*") if path.is_file() and "study.db" not in path.name}


@pytest.mark.parametrize(
    ("ended_on", "months", "due_on"),
    [
        ("2026-08-31", 6, date(2027, 2, 28)),
        ("2026-11-27", 0, date(2026, 11, 27)),
        ("2026-12-31", 1, date(2027, 1, 31)),
        ("2027-08-31", 6, date(2028, 2, 29)),
    ],
)
def test_periods_begin_at_the_end_of_the_study(ended_on: str, months: int, due_on: date) -> None:
    assert RetentionPeriods(ended_on, identities_months=months).deletion_date_by_data_kind == {
        "identities": due_on
    }
    assert RetentionPeriods(identities_months=months).deletion_date_by_data_kind == {}


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("wrong", ['ended_on = "soon"', "identities_months = -1", "names_months = 3"])
def test_error_of_an_invalid_period_has_its_line(folder: Path, wrong: str) -> None:
    state(folder, wrong + "\n")
    with pytest.raises(DesignError, match=r"study.toml:\d+: .*(allowed|Expected)"):
        read_design(folder / "study.toml")


def test_design_without_periods_has_nothing_due(folder: Path) -> None:
    assert parse_design((folder / "study.toml").read_text()).retention == RetentionPeriods()
    with StudyStore(folder) as store:
        assert list_scheduled_deletions(store) == []
        assert list(check_retention_periods(store)) == []
        assert list(delete_due_data(store, date(9999, 1, 1))) == []


def test_each_kind_of_data_has_its_due_date(store: StudyStore) -> None:
    def kinds(day: date) -> list[tuple[str, tuple[str, ...]]]:
        return [(each.data_kind, each.pseudonyms) for each in list_due_deletions(store, day)]

    both = ("sub-001", "sub-002")
    assert kinds(date(2126, 12, 29)) == []
    assert kinds(date(2126, 12, 30)) == [("identities", ("sub-001",))]
    assert kinds(date(2128, 6, 30)) == [("identities", ("sub-001",)), ("recordings", both)]
    assert kinds(date(2136, 6, 30))[-1] == ("data", both)


def test_due_names_are_deleted(store: StudyStore) -> None:
    before = files(store.folder / "recordings")
    assert list(delete_due_data(store, date(2127, 1, 1))) == [("identities", "sub-001")]
    assert identity_file.read_identities(store.folder) == {}
    assert files(store.folder / "recordings") == before
    assert [event.name for event in store.read_events()][-1] == "identity deleted by schedule"
    assert list(delete_due_data(store, date(2127, 1, 1))) == []


def test_due_recordings_are_deleted(store: StudyStore) -> None:
    assert len(list(delete_due_data(store, date(2128, 7, 1)))) == 3
    assert {path.name for path in (store.folder / "recordings").iterdir()} == {"sub-003"}
    found = [each for each in check_study(store) if each.where.startswith("recordings/")]
    assert len(found) == 4
    assert all("was deleted by schedule" in each.message and not each.is_error for each in found)
    assert len(store.read_answers("sub-001")) > 0
    assert list(delete_due_data(store, date(2128, 7, 1))) == []


def test_recording_deleted_by_hand_is_missing(store: StudyStore) -> None:
    path = store.folder / store.read_attempts("sub-001")[0].recording
    path.unlink()
    assert "is missing" in {each.message for each in check_study(store) if each.is_error}


def test_due_data_of_people_are_deleted(store: StudyStore) -> None:
    list(delete_due_data(store, date(2136, 7, 1)))
    assert [each.number for each in store.read_deleted_participants()] == [1, 2]
    assert [each.pseudonym for each in store.read_participants()] == ["sub-003"]


def test_failed_deletion_does_not_stop_others(store: StudyStore) -> None:
    session = open_session(store, "sub-001")
    with pytest.raises(StudyError, match="ses-02 of sub-001 is open"):
        list(delete_due_data(store, date(2136, 7, 1)))
    assert [each.number for each in store.read_deleted_participants()] == [2]
    close_session(store, session.id)
    list(delete_due_data(store, date(2136, 7, 1)))
    assert [each.number for each in store.read_deleted_participants()] == [1, 2]


def test_sessions_after_the_end_prevent_deletion(folder: Path) -> None:
    state(folder, 'ended_on = "2020-01-01"\nidentities_months = 0\nrecordings_years = 0\n')
    before = files(folder)
    with (
        StudyStore(folder) as store,
        pytest.raises(StudyError, match="nothing was deleted; correct ended_on"),
    ):
        list(delete_due_data(store, END))
    assert "correct ended_on" in run("retention", folder, "--delete", code=1)
    assert files(folder) == before


def test_only_the_command_deletes_due_data(store: StudyStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(retention, "today_utc", lambda: date(2127, 1, 1))
    for module in ("avrgym.study.checking.study_checks", "avrgym.study.dashboard.displayed_data"):
        monkeypatch.setattr(f"{module}.today_utc", lambda: date(2127, 1, 1))
    before = files(store.folder)
    words = "names and contacts of 1 participant must be deleted since 2126-12-30"
    (finding,) = check_retention_periods(store)
    assert words in finding.message
    assert not finding.is_error
    assert any(
        words in warning for warning in make_study_overview(store, None, store.design.furniture).warnings
    )
    assert words in run("retention", store.folder)
    assert files(store.folder) == before
    assert identity_file.read_identities(store.folder) != {}
    assert "deleted   names and contacts of sub-001" in run("retention", store.folder, "--delete")
    assert identity_file.read_identities(store.folder) == {}
    assert list(check_retention_periods(store)) == []
