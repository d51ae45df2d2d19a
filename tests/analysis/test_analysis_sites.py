"""Studies of several sites: tables contain the site, and the report describes each site."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.study.export import export_study
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.known_results import enrol_included, run_trials, write_without_figures
from helpers.studies.small_studies import small_study

SITES = {"atlanta": 4, "berlin": 3}
WITH_SITE = ("participants", "trials", "attempts", "answers", "reward_terms", "control_steps")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, StudyAnalysis, Path]:
    """A study whose participants of two sites have finished, its analysis and the folder with tables and report."""
    folder = small_study(tmp_path_factory.mktemp("study"))
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        with StudyStore(folder) as store:
            for site, people in SITES.items():
                for _ in range(people):
                    run_trials(store, enrol_included(store, simulated=False, site=site))
            analysis = analyse_study(store)
    out = tmp_path_factory.mktemp("out")
    write_without_figures(analysis, folder, out)
    return folder, analysis, out


@pytest.mark.slow
def test_every_table_of_participants_says_where(made: tuple[Path, StudyAnalysis, Path]) -> None:
    folder, _, out = made
    with StudyStore(folder) as store:
        export_study(store, "csv", out / "export")
    for table in WITH_SITE:
        rows = pd.read_csv(out / "tables" / f"{table}.csv")
        assert rows.groupby("site")["participant"].nunique().to_dict() == SITES, table
    for table in ("participants", "trials", "attempts", "answers", "control_steps"):
        rows = pd.read_csv(out / "export" / f"{table}.csv")
        assert rows.groupby("site")["participant"].nunique().to_dict() == SITES, table


def test_effects_by_site_follow_from_the_answers_of_each(made: tuple[Path, StudyAnalysis, Path]) -> None:
    _, _, out = made
    answers, effects = (pd.read_csv(out / "tables" / f"{name}.csv") for name in ("answers", "site_effects"))
    chosen = effects[effects["family"] == "policies, by participant"]
    assert len(chosen) == len(SITES) * 4
    for row in (each.to_dict() for _, each in chosen.iterrows()):
        own = answers[
            answers["counted"] & (answers["site"] == row["site"]) & (answers["item"] == row["quantity"])
        ]
        means = own.pivot_table(index="participant", columns="policy", values="value")
        differences = (means[row["group_a"]] - means[row["group_b"]]).round(9)
        used = differences[differences != 0]
        ranks = stats.rankdata(np.abs(used))
        expected = ranks[used > 0].sum() - ranks[used < 0].sum()
        assert (row["n"], row["zeros"]) == (len(used), len(differences) - len(used))
        assert row["effect"] == pytest.approx(expected / ranks.sum())
        assert row["median_a"] == pytest.approx(means[row["group_a"]].median())


def test_outcomes_by_site_add_up_to_those_of_all(made: tuple[Path, StudyAnalysis, Path]) -> None:
    _, analysis, _ = made
    for whole in analysis.objective_outcomes:
        key = (whole.task, whole.robot, whole.policy)
        parts = [row for row in analysis.site_outcomes if (row.task, row.robot, row.policy) == key]
        assert [row.site for row in parts] == list(SITES)
        assert sum(row.trials for row in parts) == whole.trials
        assert sum(row.successes for row in parts) == whole.successes


def test_the_report_describes_the_sites(made: tuple[Path, StudyAnalysis, Path]) -> None:
    _, _, out = made
    page = Page(out / "report" / "index.html")
    for words in (
        "By site",
        "Participants of each site",
        "Success over all tasks at each site",
        "Effect sizes at each site",
    ):
        assert words in page.text


@pytest.mark.slow
def test_a_study_without_sites_or_of_one_has_nothing_by_site(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "study")) as store:
        for site in ("", ""):
            run_trials(store, enrol_included(store, simulated=False, site=site))
        assert analyse_study(store).site_effects == []
        run_trials(store, enrol_included(store, site="atlanta"))
        found = analyse_study(store)
    assert found.site_outcomes == found.site_effects == []
    assert "site_effects" not in {table.name for table in found.make_tables()}
