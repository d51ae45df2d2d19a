"""Figures name the marks that they show, tables have no empty columns, and singular models are marked."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from avrgym.analysis.figures import draw_figures
from avrgym.analysis.models.effects import TrialValue, list_effects_of_interest, make_design_matrix
from avrgym.analysis.models.estimate import EffectEstimate
from avrgym.analysis.models.fitting import MIXED_MODEL, estimate_effects
from avrgym.analysis.models.mixed_models import fit_mixed_model
from avrgym.analysis.models.regression_models import ModelEffectRow
from avrgym.analysis.models.section import render_effects_table
from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.page.report_figures import add_legend
from avrgym.analysis.publication.publication_tables import make_publication_tables
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.study.design.design import parse_design, read_default_design_text
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.browser.html_page import Page
from helpers.studies.known_results import enrol_included, read_table, run_trials
from helpers.studies.small_studies import make_study

DESIGN = parse_design(read_default_design_text())
REMARK = "singular: random effect at zero: "


# Legends


def legend(figure: Figure) -> list[str]:
    return [text.get_text() for each in figure.legends for text in each.get_texts()]


def test_a_legend_names_each_mark_that_is_drawn_anywhere_once() -> None:
    figure = Figure()
    first, second = figure.subplots(1, 2)
    first.bar(0.0, 1.0, label="bars")
    first.plot([], [], "D", label="nothing")
    second.bar(0.0, 1.0, label="bars")
    second.plot([1.0], [2.0], "D", label="diamonds")
    add_legend(figure, columns=2)
    assert sorted(legend(figure)) == ["bars", "diamonds"]
    empty = Figure()
    empty.add_subplot().plot([], [], label="nothing")
    add_legend(empty, columns=1)
    assert empty.legends == []


@pytest.fixture(scope="module")
def analysis(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[StudyAnalysis, Path]]:
    """Men alone, who met two policies that nobody measured in simulation and one that training measured."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
        policies = '["oracle", "random", "revised"]'
        folder = make_study(tmp_path_factory.mktemp("study"), tasks='["Feeding"]', policies=policies)
        with StudyStore(folder) as store:
            for _ in range(4):
                run_trials(store, enrol_included(store, "man"))
            found = analyse_study(store)
        out = tmp_path_factory.mktemp("out") / "analysis"
        write_analysis(found, folder, out)
        yield found, out


def texts(svg: str) -> list[str]:
    return re.findall(r"<text[^>]*>([^<]*)</text>", svg)


@pytest.mark.slow
def test_figures_of_men_name_no_woman(analysis: tuple[StudyAnalysis, Path]) -> None:
    drawings = {each.name: texts(each.to_svg().decode()) for each in draw_figures(analysis[0])}
    heights = next(shown for name, shown in drawings.items() if name.startswith("torso-heights"))
    assert "a man" in heights
    assert "a woman" not in heights
    assert "simulation" in next(shown for name, shown in drawings.items() if name.startswith("success"))


@pytest.mark.slow
def test_what_was_not_measured_in_simulation_has_no_column_and_no_mark(
    analysis: tuple[StudyAnalysis, Path],
) -> None:
    _, out = analysis
    for policy, is_measured in (("oracle", False), ("random", False), ("revised", True)):
        (table, *_) = read_table(out, f"paper_table_1_{policy}")
        assert any(name.startswith("simulation") for name in table) is is_measured, policy
        assert all(name.startswith(("simulation", "VR", "task", "simulated")) for name in table)
    page = " ".join(Page(out / "report" / "index.html").text.split())
    assert "of oracle in virtual reality; it was not evaluated in simulation" in page
    assert "of revised in simulation and in virtual reality" in page
    for name in ("paper_table_1_oracle", "paper_table_1_revised", "paper_table_2"):
        rows = read_table(out, name)
        assert all(any(row[column] for row in rows) for column in rows[0]), name


# Singular models


def values(of_policy: float, of_participant: float, noise: float) -> list[TrialValue]:
    """Rewards of eight participants, who differ by so much in general and in what they make of a policy."""
    rng = np.random.default_rng(3)
    found: list[TrialValue] = []
    for person in range(8):
        own, likes = of_participant * rng.normal(), of_policy * rng.normal(size=len(DESIGN.policies))
        for task in DESIGN.tasks:
            for robot in DESIGN.robots:
                for index, policy in enumerate(DESIGN.policies):
                    value = own + likes[index] + noise * rng.normal()
                    before = DESIGN.policies[int(rng.integers(len(DESIGN.policies)))]
                    block, place = rng.uniform(size=2)
                    found.append(
                        TrialValue(f"sub-{person:03}", task, robot, policy, block, place, before, value)
                    )
    return found


def notes(seen: list[TrialValue]) -> set[str]:
    found = estimate_effects(DESIGN, MIXED_MODEL, seen, list_effects_of_interest(DESIGN))
    return {each.note for each in found.values() if isinstance(each, EffectEstimate)}


def test_a_random_effect_at_zero_is_named_with_every_estimate() -> None:
    seen = values(of_policy=0.0, of_participant=0.0, noise=1.0)
    (note,) = notes(seen)
    assert note.startswith(REMARK)
    named = set(note.removeprefix(REMARK).split(", "))
    assert named <= {"participant", "participant by policy", "participant by robot", "participant by task"}
    groups = [[each.participant for each in seen]]
    design = np.hstack([np.ones((len(seen), 1)), make_design_matrix(DESIGN, seen).matrix])
    fitted = fit_mixed_model([each.value for each in seen], design, groups[0], groups)
    assert fitted.zero_variance_indices == [
        place for place in (0,) if fitted.variance_components[place] <= 0.0
    ]


@pytest.mark.parametrize(
    ("of_policy", "of_participant", "differs"),
    [(3.0, 0.0, "participant by policy"), (0.0, 3.0, "participant")],
)
def test_a_random_effect_that_is_there_is_not_said_to_be_at_zero(
    of_policy: float, of_participant: float, differs: str
) -> None:
    (note,) = notes(values(of_policy, of_participant, noise=0.5))
    assert differs not in note.removeprefix(REMARK).split(", ")


SINGULAR = ModelEffectRow(
    simulated=True, family="f", quantity="reward", model=MIXED_MODEL, effect="policies", group_a="a", group_b="b",
    participants=8, values=64, estimate=1.0, error=1.0, df=7.0, low=-1.0, high=3.0, p=0.5, p_holm=0.5,
    plan_status="exploratory", note=f"{REMARK}participant by robot",
)  # fmt: skip


def test_the_report_shows_the_remark_beside_its_result() -> None:
    assert SINGULAR.note in str(render_effects_table("Models", [SINGULAR], simulated=True))


@pytest.mark.slow
def test_tables_for_publications_have_the_remark(analysis: tuple[StudyAnalysis, Path]) -> None:
    models = next(
        each
        for each in make_publication_tables(replace(analysis[0], model_effects=[SINGULAR]), True)
        if each.name == "models"
    )
    assert models.column_headings[-1] == "Remark"
    assert [row[-1] for row in models.rows] == [SINGULAR.note]
