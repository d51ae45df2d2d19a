"""Damaged and incomplete studies: each problem is listed, and the remaining data are analysed."""

import csv
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from avrgym.analysis import study_analysis
from avrgym.analysis.biomechanics import training_populations
from avrgym.analysis.figures import draw_figures
from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.cli.main import app
from avrgym.recording.configuration import Versions
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.attempts import compute_recording_sha256
from avrgym.study.storage.database_rows import TrialAttempt
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.known_results import (
    enrol_included,
    random_answer,
    read_table,
    record_trial,
    run_trials,
    write_without_figures,
)
from helpers.studies.small_studies import make_study

STORED = "reward and success come from the database"


DESIGN = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "practice_policy": '""'}
"""One robot, one task, both policies, no practice: two trials for each participant."""


@pytest.fixture(autouse=True)
def _few_people(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few people of the training: these tests are about words, not figures."""
    monkeypatch.setattr(training_populations, "SAMPLED_PEOPLE_PER_TASK", 20)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    """Nobody takes part yet."""
    with StudyStore(make_study(tmp_path / "study", **DESIGN)) as opened:
        yield opened


@pytest.fixture
def words(store: StudyStore, tmp_path: Path) -> Callable[[], str]:
    """Analyses the study; gives all words of the page."""

    def analysed() -> str:
        page = write_without_figures(analyse_study(store), store.folder, tmp_path / "out")
        return " ".join(Page(page).text.split())

    return analysed


def attempt(store: StudyStore, pseudonym: str, position: int) -> TrialAttempt:
    (found,) = (each for each in store.read_attempts(pseudonym) if f"trial-{position:02}" in each.recording)
    return found


def recording(store: StudyStore, pseudonym: str, position: int) -> Path:
    return store.resolve_path(attempt(store, pseudonym, position).recording)


def take_as_recorded(store: StudyStore, pseudonym: str, position: int) -> None:
    """Let the study know a recording as it is now."""
    found = attempt(store, pseudonym, position)
    with store.database.write_transaction() as connection:
        checksum = compute_recording_sha256(store, found.recording)
        hash_chain.update_row(connection, schema.ATTEMPT_TABLE, found.id, sha256=checksum)


def rewrite(store: StudyStore, pseudonym: str, position: int, **changes) -> None:
    """Put another recording in a trial's place."""
    path = recording(store, pseudonym, position)
    path.unlink()
    trial = store.read_trials(pseudonym)[position - 1]
    record_trial(path, store.design, store.read_participant(pseudonym), trial, **changes)


def rows_of(tmp_path: Path, table: str, **values: str) -> list[Mapping[str, str]]:
    """The rows of a table with these values."""
    rows = read_table(tmp_path / "out", table)
    return [row for row in rows if all(row[column] == value for column, value in values.items())]


# Little data


def test_an_empty_study(store: StudyStore, tmp_path: Path) -> None:
    page = write_analysis(analyse_study(store), store.folder, tmp_path / "out")
    assert "There are no participants yet." in Page(page).text
    for path in (tmp_path / "out" / "tables").glob("*.csv"):
        rows = list(csv.reader(path.read_text(encoding="utf-8-sig").splitlines()))
        assert rows[0], path.name
        assert len(rows) == 1 or path.stem in ("people", "biomechanics"), path.name
    assert list((tmp_path / "out" / "figures").iterdir()) == []


def test_someone_enrolled_without_any_trial(store: StudyStore, words: Callable[[], str]) -> None:
    enrol_included(store, simulated=False)
    said = words()
    assert "No trial was completed yet." in said
    assert "No questionnaire item was answered yet." in said
    assert "No analysed trial has a complete recording of the body posture." in said


@pytest.mark.slow
def test_one_participant(store: StudyStore, words: Callable[[], str], tmp_path: Path) -> None:
    run_trials(store, enrol_included(store, simulated=False))
    assert "SIMULATED" not in words()
    (row,) = rows_of(tmp_path, "objective", policy="revised", task="Feeding")
    assert (row["trials"], row["reward_low"], row["reward_high"]) == ("1", "", "")
    rows = rows_of(tmp_path, "tests", family="policies, by participant")
    assert {row["n_a"] for row in rows} == {"1"}


@pytest.mark.slow
def test_all_answers_equal(store: StudyStore, words: Callable[[], str], tmp_path: Path) -> None:
    for _ in range(2):
        run_trials(store, enrol_included(store), rate=lambda *_: 4)
    assert "Wilcoxon signed-rank, all differences are zero" in words()
    rows = [row for row in read_table(tmp_path / "out", "tests") if row["quantity"] in ("L1", "L2")]
    assert {(row["n"], row["p"], row["p_holm"], row["stars"]) for row in rows} == {("0", "", "", "")}


@pytest.mark.slow
def test_a_trial_without_its_partner_is_left_out_of_pairs(
    store: StudyStore, words: Callable[[], str], tmp_path: Path
) -> None:
    run_trials(store, enrol_included(store))
    run_trials(store, enrol_included(store), 1)
    words()
    rows = [row for row in read_table(tmp_path / "out", "tests") if row["family"] == "policies, by trial"]
    assert {row["n_a"] for row in rows} == {"1"}


# Recordings


@dataclass(frozen=True)
class Broken:
    """The analysis of a study in which every trial but one has something else that is wrong."""

    analysis: StudyAnalysis
    words: str
    out: Path


@pytest.fixture(scope="module")
def broken(tmp_path_factory: pytest.TempPathFactory) -> Broken:
    folder = tmp_path_factory.mktemp("broken")
    with (
        pytest.MonkeyPatch.context() as monkeypatch,
        StudyStore(make_study(folder / "study", **DESIGN)) as store,
    ):
        monkeypatch.setattr(training_populations, "SAMPLED_PEOPLE_PER_TASK", 20)
        for simulated in (True, True, False, True):
            run_trials(store, enrol_included(store, simulated=simulated))
        cut = recording(store, "sub-001", 1)
        cut.write_bytes(cut.read_bytes()[: cut.stat().st_size * 2 // 3])
        recording(store, "sub-001", 2).unlink()
        recording(store, "sub-002", 1).write_bytes(b"foreign")
        rewrite(store, "sub-002", 2, versions=Versions("0.0.1", "3.9.0"))
        rewrite(store, "sub-003", 1, simulated=True)
        rewrite(store, "sub-003", 2, joint_names=("waist_x",))
        rewrite(store, "sub-004", 1, other_course=9)
        for pseudonym, position in product(("sub-001", "sub-002", "sub-003", "sub-004"), (1, 2)):
            take_as_recorded(store, pseudonym, position)
        analysis = analyse_study(store)
        page = write_without_figures(analysis, store.folder, folder / "out")
    return Broken(analysis, " ".join(Page(page).text.split()), folder / "out")


@pytest.mark.parametrize(
    ("participant", "position", "recorded", "said"),
    [
        ("sub-001", 1, "cut off", "is cut off: it contains"),
        ("sub-001", 1, "cut off", f"of 5 control steps: {STORED}; the trial is not in the biomechanics."),
        (
            "sub-001",
            2,
            "missing",
            f"is missing: {STORED}; the trial is not in the biomechanics and has no time",
        ),
        (
            "sub-002",
            1,
            "unreadable",
            "cannot be read: not a recording, or truncated before the end of its header",
        ),
        ("sub-002", 2, "whole", "was recorded with AVR Gym 0.0.1 (now "),
        ("sub-002", 2, "whole", "MuJoCo 3.9.0 (now "),
        (
            "sub-003",
            1,
            "contradictory",
            "differ in whether the participant was simulated: the trial is not in the analysis.",
        ),
        (
            "sub-003",
            2,
            "without a body",
            "does not contain the body model of this version: reward and success",
        ),
        ("sub-004", 1, "whole", "has a total reward of"),
        ("sub-004", 2, "whole", "7 problems:"),
    ],
)
def test_each_recording_gets_its_word(
    broken: Broken, participant: str, position: int, recorded: str, said: str
) -> None:
    (row,) = rows_of(broken.out.parent, "trials", participant=participant, position=str(position))
    assert row["recorded"] == recorded
    assert said in broken.words


def test_the_rest_of_the_analysis_still_comes(broken: Broken) -> None:
    rows = rows_of(broken.out.parent, "trials")
    assert [row["counted"] for row in rows].count("true") == 7
    assert all(row["reward"] for row in rows)
    assert [bool(row["head_z_m"]) for row in rows] == [False] * 3 + [True, False, False, True, True]
    assert "No time series: the recording is missing." in broken.words


@pytest.mark.slow
def test_figures_show_what_can_be_read(broken: Broken) -> None:
    assert {each.name for each in draw_figures(broken.analysis)} >= {
        "likert-people",
        "head-positions-simulated",
    }


def test_answers_to_a_trial_that_does_not_count_do_not_count(broken: Broken) -> None:
    answered = [row["counted"] for row in rows_of(broken.out.parent, "answers", participant="sub-003")]
    assert sorted(answered) == ["false"] * 4 + ["true"] * 4


def test_changed_recordings_are_named_and_nothing_is_analysed(store: StudyStore, tmp_path: Path) -> None:
    run_trials(store, enrol_included(store))
    for position in (1, 2):
        rewrite(store, "sub-001", position, other_course=9)
    result = avrgym("analyze", store.folder, "--out", tmp_path / "out")
    assert result.exit_code == 1
    for position in (1, 2):
        name = attempt(store, "sub-001", position).recording
        assert f"{name} was changed: its checksum differs" in result.stderr
    assert "--skip-damaged" in result.stderr
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_nothing_of_changed_recordings_is_used_where_they_are_skipped(
    store: StudyStore, tmp_path: Path
) -> None:
    run_trials(store, enrol_included(store))
    rewrite(store, "sub-001", 1, other_course=9)
    assert avrgym("analyze", store.folder, "--out", tmp_path / "out", "--skip-damaged").exit_code == 0
    changed, whole = read_table(tmp_path / "out", "trials")
    assert (changed["recorded"], whole["recorded"]) == ("changed", "whole")
    assert (changed["reward_recorded"], changed["torso_height_m"]) == ("", "")
    assert float(changed["reward"]) == attempt(store, "sub-001", 1).metrics.reward
    assert {row["position"] for row in read_table(tmp_path / "out", "control_steps")} == {"2"}
    (problem,) = read_table(tmp_path / "out", "problems")
    assert problem["what"] == "was changed: its checksum differs"


# Policies


@pytest.mark.slow
def test_a_policy_that_is_not_found(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path / "other", **DESIGN, policies='["original", "mine"]')) as other:
        run_trials(other, enrol_included(other))
        page = write_analysis(analyse_study(other), other.folder, tmp_path / "out")
    said = " ".join(Page(page).text.split())
    assert "Simulation of Feeding Jaco mine: no policy 'mine' for avrgym/FeedingJaco-v1" in said
    rows = {
        row["policy"]: row for row in read_table(tmp_path / "out", "objective") if row["task"] == "Feeding"
    }
    assert rows["original"]["simulation_reward_mean"]
    assert not rows["mine"]["simulation_reward_mean"]


# Folders


@pytest.mark.slow
def test_files_of_an_earlier_analysis_are_replaced_and_others_stay(store: StudyStore, tmp_path: Path) -> None:
    def write() -> None:
        write_analysis(analyse_study(store), store.folder, tmp_path / "out")

    write()
    own = tmp_path / "out" / "figures" / "mine.svg"
    own.write_text("mine")
    run_trials(store, enrol_included(store))
    write()
    assert own.read_text() == "mine"
    assert len(read_table(tmp_path / "out", "trials")) == 2
    made = (tmp_path / "out" / "figures" / "likert-simulated.svg").exists()
    delete_participant(store, "sub-001")
    write()
    assert (made, (tmp_path / "out" / "figures" / "likert-simulated.svg").exists()) == (True, False)


def test_a_folder_with_tables_of_other_origin_is_refused(store: StudyStore, tmp_path: Path) -> None:
    theirs = tmp_path / "out" / "tables" / "trials.csv"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("theirs")
    (tmp_path / "out" / "results.json").write_text("{}")
    with pytest.raises(StudyError, match="was not written by an analysis; choose another folder"):
        write_analysis(analyse_study(store), store.folder, tmp_path / "out")
    assert theirs.read_text() == "theirs"


@pytest.mark.slow
def test_deleting_a_participant_deletes_the_analysis_in_the_study(store: StudyStore) -> None:
    run_trials(store, enrol_included(store))
    out = store.folder / "analysis"
    write_analysis(analyse_study(store), store.folder, out)
    (out / "notes.txt").write_text("mine")
    delete_participant(store, "sub-001")
    assert [path.name for path in out.rglob("*") if path.is_file()] == ["notes.txt"]


# The command


def avrgym(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.mark.slow
def test_the_command_writes_into_the_study_and_its_figures_to_a_file(
    store: StudyStore, tmp_path: Path
) -> None:
    run_trials(store, enrol_included(store), rate=random_answer)
    recording(store, "sub-001", 1).unlink()
    result = avrgym("analyze", store.folder, "--json", tmp_path / "figures.json")
    assert result.exit_code == 0
    assert f"report    {store.folder / 'analysis' / 'report' / 'index.html'}" in result.stdout
    assert "problems: 1; the report lists each" in result.stdout
    figures = json.loads((tmp_path / "figures.json").read_text())
    stored = json.loads((store.folder / "analysis" / "results.json").read_text())
    assert {name: stored[name] for name in figures} == figures
    assert figures["format"] == study_analysis.RESULTS_FORMAT


def test_the_command_refuses_in_one_line(tmp_path: Path) -> None:
    result = avrgym("analyze", tmp_path)
    assert result.exit_code == 1
    assert "contains no study.toml" in result.stderr
    assert len(result.stderr.splitlines()) == 1
