"""Publication files: facts of the study, missing facts, and marks of simulated participants."""

import csv
import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pandas as pd
import pytest

from avrgym.analysis.biomechanics.training_populations import SAMPLED_PEOPLE_PER_TASK
from avrgym.analysis.figures import draw_figures
from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.page.hypothesis_test_tables import format_sample_size
from avrgym.analysis.page.report_figures import ReportFigure
from avrgym.analysis.participant_flow import ParticipantFlow, draw_flow_chart, make_flow_steps
from avrgym.analysis.publication.checklist import make_checklist_fields
from avrgym.analysis.publication.methods import make_methods_sections, select_publication_flow
from avrgym.analysis.publication.publication_tables import format_latex_table, make_publication_tables
from avrgym.analysis.reading.table_rows import DataProblemRow
from avrgym.analysis.report import write_report
from avrgym.analysis.statistics.comparisons import PARTICIPANT_UNIT
from avrgym.analysis.study_analysis import StudyAnalysis, analyse_study
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.people.participants import (
    enrol_participant,
    record_consent,
    record_inclusion_answers,
    withdraw_participant,
)
from avrgym.study.storage.store import StudyStore
from helpers.studies.known_results import enrol_included, run_trials, write_without_figures
from helpers.studies.small_studies import eligible_answers, small_study

PEOPLE = 5


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    """Five people who finished; one who withdrew, one excluded, one without consent, one deleted; a simulated one."""
    with StudyStore(small_study(tmp_path_factory.mktemp("reported"))) as opened:
        for number in range(PEOPLE):
            run_trials(opened, enrol_included(opened, "man" if number % 2 else "woman", simulated=False))
        gone = enrol_included(opened, simulated=False)
        run_trials(opened, gone, 2)
        withdraw_participant(opened, gone, "felt sick")
        excluded = enrol_participant(opened, "man", age_years=30)
        record_consent(opened, excluded)
        record_inclusion_answers(
            opened, excluded, {name: not fits for name, fits in eligible_answers(opened).items()}
        )
        enrol_participant(opened, "man", age_years=None)
        deleted = enrol_included(opened, simulated=False)
        delete_participant(opened, deleted)
        run_trials(opened, enrol_included(opened, simulated=True))
        yield opened


@pytest.fixture(scope="module")
def analysis(store: StudyStore) -> StudyAnalysis:
    return analyse_study(store)


@pytest.fixture(scope="module")
def out(store: StudyStore, analysis: StudyAnalysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    write_without_figures(analysis, store.folder, folder)
    return folder


# The flow


def words_of(drawing: ReportFigure) -> str:
    return " ".join(" ".join(ET.fromstring(drawing.to_svg()).itertext()).split())


def test_everybody_is_somewhere_in_the_flow(analysis: StudyAnalysis) -> None:
    people, simulated = analysis.participant_flows
    assert (people.is_simulated, simulated.is_simulated) == (False, True)
    for flow in analysis.participant_flows:
        left = (
            flow.deleted_participant_count
            + flow.without_consent_count
            + flow.excluded_participant_count
            + flow.early_withdrawal_count
            + flow.awaiting_allocation_count
        )
        assert flow.enrolled_participant_count == left + flow.allocated_participant_count
        assert (
            flow.allocated_participant_count
            == flow.late_withdrawal_count
            + flow.unfinished_participant_count
            + flow.completed_participant_count
        )
        assert sum(flow.participants_by_order.values()) == flow.allocated_participant_count
    seen = (
        people.enrolled_participant_count,
        people.deleted_participant_count,
        people.without_consent_count,
        people.excluded_participant_count,
        people.late_withdrawal_count,
        people.analysed_participant_count,
    )
    assert seen == (9, 1, 1, 1, 1, PEOPLE)
    assert people.participants_by_consent_version == {"1": PEOPLE + 2}
    assert simulated.enrolled_participant_count == simulated.completed_participant_count == 1


def test_the_chart_shows_each_step_and_who_left(analysis: StudyAnalysis, out: Path) -> None:
    for name in ("people", "simulated"):
        ET.fromstring((out / "reporting" / f"flow-{name}.svg").read_text())
    shown = words_of(draw_flow_chart(analysis.participant_flows[0]))
    for words, left in make_flow_steps(analysis.participant_flows[0]):
        assert words in shown
        assert all(each in shown for each in left)
    assert "1 excluded by the inclusion questions" in shown
    assert "SIMULATED" not in shown
    assert "SIMULATED PARTICIPANTS" in words_of(draw_flow_chart(analysis.participant_flows[1]))
    for name in ("people", "simulated"):
        assert (out / "reporting" / f"flow-{name}.pdf").read_bytes().startswith(b"%PDF")


# Words


def test_the_methods_say_what_is_known_and_what_is_missing(analysis: StudyAnalysis, out: Path) -> None:
    text = (out / "reporting" / "methods.md").read_text()
    enrolled, _, _, analysed = make_flow_steps(analysis.participant_flows[0])
    assert f"9 participants enrolled (left: {', '.join(enrolled[1])})." in text
    assert "6 received an order of trials (left: 1 withdrew (felt sick: 1))." in text
    assert f"5 completed the study. {analysed[0]}." in text
    assert "Of the 5 participants in the analysis: Age: 22 to 22 years" in text
    assert "3 were represented by a woman's body model, 2 by a man's" in text
    missing = re.findall(r"\[MISSING: ([^\]]*)\]", text)
    assert len(missing) == 7
    assert "board and number of the approval" in missing
    assert "L1: “The robot successfully assisted me with the task.”" in text
    assert "Nothing was preregistered" in text
    assert "SIMULATED" not in text
    page = (out / "reporting" / "index.html").read_text()
    assert page.count('class="missing">[MISSING:') == len(missing)


def test_what_is_given_is_no_longer_missing(analysis: StudyAnalysis) -> None:
    given = msgspec.structs.replace(analysis.design.reporting, ethics_approval="Board 7, H19212")
    told = replace(analysis, design=msgspec.structs.replace(analysis.design, reporting=given))
    flow = select_publication_flow(told)
    assert flow is not None
    assert "Ethics approval: Board 7, H19212" in make_methods_sections(told, flow)["Participants"]
    (ethics,) = (each for each in make_checklist_fields(told, flow) if each.field == "Ethics approval")
    assert ethics.value == "Board 7, H19212"


def test_the_list_of_fields_shows_in_red_what_is_missing(analysis: StudyAnalysis, out: Path) -> None:
    with open(out / "reporting" / "checklist.csv", encoding="utf-8-sig", newline="") as file:
        rows = list(csv.DictReader(file))
    lacking = {row["field"] for row in rows if row["missing"] == "true"}
    assert {
        "Recruitment",
        "Compensation",
        "Ethics approval",
        "Preregistration",
        "Headset and controllers",
    } <= lacking
    assert {"Number of participants", "Age", "Informed consent", "Dates", "Blinding"}.isdisjoint(lacking)
    assert all(bool(row["value"]) != (row["missing"] == "true") for row in rows)
    page = (out / "reporting" / "index.html").read_text()
    assert f"{len(lacking)} of {len(rows)} fields are missing." in page
    assert page.count('class="missing">missing<') == len(lacking)
    assert ".missing { color:" in page


@pytest.mark.slow
def test_a_dry_run_is_called_simulated_everywhere(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "dry")) as store:
        run_trials(store, enrol_included(store, simulated=True))
        write_analysis(analyse_study(store), store.folder, tmp_path / "out")
    folder = tmp_path / "out" / "reporting"
    text = (folder / "methods.md").read_text()
    assert text.index("SIMULATED PARTICIPANTS") < text.index("## Participants")
    assert "1 simulated participant enrolled" in text
    assert "informed consent" not in text
    for path in (*folder.glob("*.tex"), *folder.glob("*.svg"), folder / "index.html"):
        assert "SIMULATED PARTICIPANTS" in path.read_text(), path.name
    assert not list(folder.glob("*-people.*"))


def test_a_study_with_nobody_in_it_has_a_codebook_and_says_so(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "empty")) as store:
        write_analysis(analyse_study(store), store.folder, tmp_path / "out")
    folder = tmp_path / "out" / "reporting"
    assert {path.name for path in folder.iterdir()} == {"index.html", "codebook.csv", "schema.json"}
    assert "The study has no participants yet" in (folder / "index.html").read_text()


# Tables and codebook


def test_latex_escapes_what_it_would_run() -> None:
    text = format_latex_table(
        "50 % & more", ("a_b", "n"), [(r"\input{x}", "−1 × 2"), ("#", "<3>")], numbers=(1,)
    )
    assert r"\caption{50 \% \& more}" in text
    assert r"a\_b & n \\" in text
    assert r"\textbackslash{}input\{x\} & $-$1 $\times$ 2 \\" in text
    assert r"\# & $<$3$>$ \\" in text
    assert r"\begin{tabular}{lr}" in text


def test_every_column_of_every_table_is_in_the_codebook(analysis: StudyAnalysis, out: Path) -> None:
    book: Any = pd.read_csv(out / "reporting" / "codebook.csv", keep_default_na=False)
    assert (book["meaning"] != "").all()
    listed = {(row.table, row.column) for row in book.itertuples()}
    files = {path.stem: pd.read_csv(path, nrows=1) for path in (out / "tables").glob("*.csv")}
    assert listed == {(name, column) for name, frame in files.items() for column in frame.columns}


def test_results_are_as_the_schema_says(out: Path) -> None:
    """Types, required and unknown columns, and empty cells, of every row in the results."""
    schema = json.loads((out / "reporting" / "schema.json").read_text())["properties"]
    results = json.loads((out / "results.json").read_text())
    kinds = {"string": str, "integer": int, "number": (int, float), "boolean": bool, "null": type(None)}
    checked = 0
    for name in set(schema) & set(results):
        row_schema = schema[name]["items"]
        for row in results[name]:
            assert list(row) == row_schema["required"], name
            for column, value in row.items():
                types = row_schema["properties"][column]["type"]
                allowed = [types] if isinstance(types, str) else types
                fits = [isinstance(value, kinds[kind]) for kind in allowed]
                assert any(fits), (name, column, value)
                assert value is None or isinstance(value, bool) == (allowed[0] == "boolean"), (name, column)
            checked += 1
    assert checked > 500


def test_the_data_package_describes_the_files_beside_it(out: Path) -> None:
    package = json.loads((out / "tables" / "datapackage.json").read_text())
    assert {each["path"] for each in package["resources"]} == {
        path.name for path in (out / "tables").glob("*.csv")
    }
    for resource in package["resources"]:
        frame: Any = pd.read_csv(out / "tables" / resource["path"], keep_default_na=False, dtype=str)
        fields = resource["schema"]["fields"]
        assert [field["name"] for field in fields] == list(frame.columns)
        for field in fields:
            if field.get("constraints", {}).get("required"):
                assert (frame[field["name"]] != "").all(), (resource["name"], field["name"])


def test_a_flow_without_anybody_leaving_tells_of_nobody() -> None:
    flow = ParticipantFlow(
        is_simulated=False, enrolled_participant_count=2, deleted_participant_count=0, without_consent_count=0,
        excluded_participant_count=0, early_withdrawal_count=0,
        awaiting_allocation_count=0, allocated_participant_count=2,
        late_withdrawal_count=0, unfinished_participant_count=0, completed_participant_count=2,
        analysed_participant_count=2, participants_by_order={1: 2},
        participants_by_consent_version={"1": 2},
        first_session_day=None, last_session_day=None,
    )  # fmt: skip
    assert [left for _, left in make_flow_steps(flow)] == [[], [], [], []]


# Who is in the analysis


@pytest.mark.slow
def test_the_flow_names_why_people_left_and_who_is_analysed(tmp_path: Path) -> None:
    """One finished, one has a trial left, one left in the first; one was too young, and one changed their mind."""
    with StudyStore(small_study(tmp_path)) as store:
        run_trials(store, enrol_included(store, "man", simulated=False))
        run_trials(store, enrol_included(store, "woman", simulated=False), 3)
        enrol_included(store, "woman", simulated=False)
        young = enrol_participant(store, "woman", age_years=17)
        record_consent(store, young)
        record_inclusion_answers(store, young, eligible_answers(store) | {"adult": False})
        withdraw_participant(store, enrol_participant(store, "man", age_years=70), "no time")
        found = analyse_study(store)
    (flow,) = found.participant_flows
    assert flow.exclusions_by_answer == {"Are you 18 years old or older? No": 1}
    assert (flow.early_withdrawals_by_reason, flow.late_withdrawals_by_reason) == ({"no time": 1}, {})
    assert (
        flow.completed_participant_count,
        flow.analysed_participant_count,
        flow.unfinished_analysed_participant_count,
    ) == (1, 2, 1)
    assert make_flow_steps(flow)[-1] == ("In the analysis: 2, of them 1 not finished yet", [])
    about = " ".join(make_methods_sections(found, flow)["Participants"])
    assert "Of the 2 participants in the analysis: Age: 22 to 22 years" in about
    assert "1 were represented by a woman's body model, 1 by a man's" in about
    tables = {table.name: table for table in make_publication_tables(found, simulated=False)}
    assert [row[:3] for row in tables["participants"].rows] == [
        ("man", 1, "22.0 (22 to 22)"),
        ("woman", 1, "22.0 (22 to 22)"),
    ]


def test_who_completed_a_study_without_data_that_count_is_not_analysed() -> None:
    flow = ParticipantFlow(
        is_simulated=False, enrolled_participant_count=2, deleted_participant_count=0, without_consent_count=0,
        excluded_participant_count=0, early_withdrawal_count=0,
        awaiting_allocation_count=0, allocated_participant_count=2,
        late_withdrawal_count=0, unfinished_participant_count=0, completed_participant_count=2,
        analysed_participant_count=1, participants_by_order={1: 2},
        participants_by_consent_version={"1": 2},
        first_session_day=None, last_session_day=None, completed_unanalysed_participant_count=1,
    )  # fmt: skip
    assert make_flow_steps(flow)[2] == ("Completed the study: 2", ["1 without an analysed trial or answer"])


# What a reader could misread


def test_inclusion_questions_are_listed_with_the_answer_that_let_people_in(analysis: StudyAnalysis) -> None:
    flow = select_publication_flow(analysis)
    assert flow is not None
    (asked,) = (each for each in make_checklist_fields(analysis, flow) if each.field == "Inclusion criteria")
    assert "with glasses if you need them? Yes." in asked.value
    assert "Have you ever had epilepsy? No." in asked.value


def test_the_numbers_of_values_are_those_of_each_group(analysis: StudyAnalysis) -> None:
    rows = [row for row in analysis.tests if not row.simulated and row.unit == PARTICIPANT_UNIT]
    unpaired = [row for row in rows if row.test == "Mann-Whitney"]
    assert unpaired
    assert {format_sample_size(row) for row in unpaired} == {f"{PEOPLE} / {SAMPLED_PEOPLE_PER_TASK}"}
    of_equal_size = replace(unpaired[0], n_a=20, n_b=20, n=40)
    assert format_sample_size(of_equal_size) == "20 / 20"
    for row in rows:
        if row.test != "Mann-Whitney" and row.n_a == row.n_b:
            zeros = f" + {row.zeros} zero" if row.zeros else ""
            assert format_sample_size(row) == f"{row.n}{zeros}"


def test_a_problem_of_many_recordings_is_shown_once_and_names_each(
    analysis: StudyAnalysis, tmp_path: Path
) -> None:
    problems = [
        DataProblemRow(simulated=False, where=f"trial-{number}.mcap", what="is old", consequence="it is used")
        for number in range(30)
    ]
    alone = DataProblemRow(simulated=False, where="one.mcap", what="is missing", consequence="no body")
    seen = replace(analysis.study_data, problems=[*problems, alone])
    write_report(tmp_path / "page.html", replace(analysis, study_data=seen), [], "..")
    text = (tmp_path / "page.html").read_text()
    assert text.count("is old") == 1
    assert "30 times: is old: it is used." in text
    assert "one.mcap is missing: no body." in text
    assert all(row.where in text for row in problems)
    assert "31 problems:" in text


@pytest.mark.slow
def test_simulation_of_another_length_is_named_before_the_figures(
    analysis: StudyAnalysis, tmp_path: Path
) -> None:
    note = "episodes have 200 steps, these trials 60"
    objective = [replace(row, simulation_note=note) for row in analysis.objective_outcomes]
    told = replace(analysis, objective_outcomes=objective)
    write_report(tmp_path / "page.html", told, draw_figures(told), "..")
    page = (tmp_path / "page.html").read_text()
    assert 0 < page.index(note) < page.index("<figure>")
    assert "-0.000" not in page


@pytest.mark.parametrize(
    ("tasks", "said", "not_said"),
    [
        (("Feeding", "ScratchItch"), "sat on a seat 0.485 m high. A force guard", "mattress"),
        (("BedBathing",), "lay on a mattress 0.55 m high with its back at 60°. A force", "sat on"),
        (("Feeding", "BedBathing"), "sat on a seat 0.485 m high and lay on a mattress", "drinking"),
    ],
)
def test_the_methods_name_the_furniture_and_withdrawals_of_the_tasks(
    analysis: StudyAnalysis, tasks: tuple[str, ...], said: str, not_said: str
) -> None:
    design = msgspec.structs.replace(analysis.design, tasks=tasks)
    told, flow = replace(analysis, design=design, session_designs=[]), select_publication_flow(analysis)
    assert flow is not None
    words = " ".join(make_methods_sections(told, flow)["Apparatus"])
    assert said in words
    assert not_said not in words
    assert ("After success in feeding the robot withdrew" in words) == ("Feeding" in tasks)
