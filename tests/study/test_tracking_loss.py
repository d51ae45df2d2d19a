"""The share of tracking loss in a trial, and the exclusion of trials above the limit."""

from pathlib import Path

import pytest

from avrgym.analysis.study_analysis import analyse_study
from avrgym.recording.reader import Recording
from avrgym.recording.schema import Control, Event, TrackingFrame
from avrgym.study.checking.study_checks import check_study
from avrgym.study.checking.tracking_loss import compute_tracking_loss_fraction
from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.storage.store import StudyStore
from helpers.studies.configurations import made_recording
from helpers.studies.known_results import STEPS, enrol_included, run_trials, write_without_figures
from helpers.studies.small_studies import make_study

RATE_HZ = 100
DRIVEN_S = 20.0


def recording(*frames: tuple[float, bool, list[str]]) -> Recording:
    """A recording with the robot active from 5 to 25 s and frames with and without tracking."""
    messages = [("/events", 5_000_000_000, Event("phase", "trial"))]
    messages += [
        (
            "/tracking",
            round(1e9 * time_s),
            TrackingFrame(0, 0.0, time_s, not held, held, rejected_parts=parts),
        )
        for time_s, held, parts in frames
    ]
    messages += [
        ("/control", 5_000_000_000 + 100_000_000 * step, Control(step, [], [], 0.0, {}, False, 0.0, 0.0))
        for step in range(1, 201)
    ]
    return made_recording(*messages)


def at_rate(held, begin_s: float = 4.0, end_s: float = 26.0, parts=lambda number: []) -> Recording:
    count = round(RATE_HZ * (end_s - begin_s))
    return recording(*((begin_s + n / RATE_HZ, held(n), parts(n)) for n in range(count)))


@pytest.mark.parametrize("every", [1, 2, 4, 10, 20])
@pytest.mark.fast_cases(2)
def test_share_counts_held_frames(every: int) -> None:
    assert compute_tracking_loss_fraction(at_rate(lambda n: n % every == 0)) == pytest.approx(
        1.0 / every, abs=1e-6
    )
    parts = at_rate(lambda n: False, parts=lambda n: ["left"] if n % every == 0 else [])
    assert compute_tracking_loss_fraction(parts) == pytest.approx(1.0 / every, abs=1e-6)


def test_share_with_and_without_tracking() -> None:
    assert compute_tracking_loss_fraction(at_rate(lambda n: False)) == pytest.approx(0.0, abs=1e-9)
    assert compute_tracking_loss_fraction(at_rate(lambda n: True)) == 1.0
    assert compute_tracking_loss_fraction(recording()) == 1.0


@pytest.mark.parametrize("silent_s", [0.1, 0.9, 5.0, 19.0])
def test_missing_frames_count_after_the_last_is_stale(silent_s: float) -> None:
    before = at_rate(lambda n: False, end_s=25.0 - silent_s).messages
    messages = [*before]
    expected = max(0.0, silent_s - 0.2 + 1.0 / RATE_HZ) / DRIVEN_S
    assert compute_tracking_loss_fraction(made_recording(*messages)) == pytest.approx(expected, abs=1e-6)


def test_only_time_with_the_robot_counts() -> None:
    frames = at_rate(lambda n: n < RATE_HZ or n >= 21 * RATE_HZ)
    assert compute_tracking_loss_fraction(frames) == pytest.approx(0.0, abs=1e-9)
    assert compute_tracking_loss_fraction(made_recording()) is None


# Studies -----------------------------------------------------------------------------------------------------


def small_study(folder: Path, **changes: str) -> Path:
    return make_study(folder, tasks='["Feeding"]', robots='["Jaco"]', practice_policy='""', **changes)


@pytest.mark.slow
def test_trials_with_excess_tracking_loss_are_excluded(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "study", max_held_share="0.3")) as store:
        pseudonym = enrol_included(store)
        run_trials(store, pseudonym, held={1: 1, 2: STEPS})
        analysis = analyse_study(store)
        page = write_without_figures(analysis, store.folder, tmp_path / "out").read_text()
        findings = [finding for finding in check_study(store) if "held" in finding.message]
    first, second = analysis.make_results()["trials"]
    assert (first["counted"], first["left_out"]) == (True, None)
    assert second["counted"] is False
    assert "tracking was lost for 100.0 %" in second["left_out"]
    assert "max_held_share allows 30 %" in second["left_out"]
    assert [answer.position for answer in analysis.study_data.answers if answer.counted] == [1] * 4
    assert sum(row.trials for row in analysis.objective_outcomes if row.task == "Feeding") == 1
    assert "Excluded from the analyses" in page
    assert f"{pseudonym}, trial 2: tracking was lost for 100.0 %" in page
    (problem,) = (each for each in analysis.make_results()["problems"] if "left out" in each["what"])
    assert problem["where"] == second["recording"]
    (finding,) = findings
    assert (finding.where, finding.is_error) == (f"{pseudonym}, trial 2", False)
    assert "tracking was lost for 100.0 %" in finding.message


def test_design_without_a_limit_counts_all_trials(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("max_held_share = 0.05\n", ""))
    with StudyStore(folder) as store:
        run_trials(store, enrol_included(store), held={1: STEPS})
        rows = analyse_study(store).study_data.trials
        assert not [finding for finding in check_study(store) if "held" in finding.message]
    assert all(row.counted for row in rows)
    assert rows[0].tracking_loss_share == 1.0


@pytest.mark.parametrize("share", ["-0.1", "1.1", "nan", '"5 %"'])
def test_share_is_between_0_and_1(share: str) -> None:
    text = read_default_design_text().replace("max_held_share = 0.05", f"max_held_share = {share}")
    with pytest.raises(DesignError, match="max_held_share"):
        parse_design(text)
