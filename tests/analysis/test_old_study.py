"""Analysis of a study of an earlier version: scales of answers, participants in the flow, formats of figures."""

import shutil
from pathlib import Path

import pytest

from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore

OLD = Path(__file__).parents[1] / "data" / "study-of-0.2.0"


@pytest.fixture
def old(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    return Path(shutil.copytree(OLD, tmp_path / "old"))


def check_rows(found: StudyAnalysis) -> None:
    assert {(row.minimum, row.maximum, row.points) for row in found.study_data.answers} == {
        (0, 3, 4),
        (0, 100, 21),
        (1, 7, 7),
    }
    assert {row.value for row in found.answer_frequencies if row.item.startswith("L")} == set(range(1, 8))
    for flow in found.participant_flows:
        assert flow.analysed_participant_count == len(
            found.study_data.find_analysed_participants(simulated=flow.is_simulated)
        )
        assert (
            flow.analysed_participant_count
            <= flow.completed_participant_count + flow.unfinished_participant_count
        )


def test_an_old_study_is_analysed_on_the_scales_of_its_items(old: Path) -> None:
    with StudyStore(old) as store:
        check_rows(analyse_study(store))


@pytest.mark.slow
def test_the_report_of_an_old_study_has_every_figure_in_both_formats(old: Path, tmp_path: Path) -> None:
    with StudyStore(old) as store:
        write_analysis(analyse_study(store), store.folder, tmp_path / "out")
    figures = {path.relative_to(tmp_path) for path in tmp_path.glob("out/*/*.svg")}
    assert figures
    assert {
        path.with_suffix(".svg")
        for path in (each.relative_to(tmp_path) for each in tmp_path.glob("out/*/*.pdf"))
    } == figures
