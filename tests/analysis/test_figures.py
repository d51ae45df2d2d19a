"""Laws of every figure: labelled axes, no overlapping or truncated text, and fonts inside the PDF."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, product

import msgspec
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from avrgym.analysis.answers.figures import (
    draw_mean_answer_figures,
    draw_session_answer_figures,
    draw_trial_answer_figures,
)
from avrgym.analysis.answers.session_answers import (
    compute_session_test_families,
    make_session_answer_frequency_rows,
)
from avrgym.analysis.answers.trial_answers import (
    compute_answer_test_families,
    make_answer_frequency_rows,
    make_answer_summary_rows,
)
from avrgym.analysis.biomechanics.body_measures import group_posture_trials
from avrgym.analysis.biomechanics.figures import draw_head_position_figure, draw_torso_height_figure
from avrgym.analysis.biomechanics.training_populations import sample_training_populations
from avrgym.analysis.outcomes.condition_outcomes import ObjectiveOutcomeRow
from avrgym.analysis.outcomes.figures import draw_reward_figure, draw_success_figure
from avrgym.analysis.page.report_figures import ReportFigure
from avrgym.analysis.participant_flow import ParticipantFlow, draw_flow_chart
from avrgym.analysis.reading.table_rows import AnswerRow, TrialRow
from avrgym.questionnaires.questionnaire import QUESTION_MOMENTS, Item, Questionnaire
from avrgym.questionnaires.registry import INSTRUMENTS
from avrgym.study.design.design import Design, parse_design, read_default_design_text

PEOPLE = 8
SLACK_PX = 1.0
"""By how much boxes of words may overlap: letters do not fill them."""
FAST = ("paper", "own", "many policies", "nasa-tlx")
STUDIES = [
    *FAST,
    *(pytest.param(name, marks=pytest.mark.slow) for name in INSTRUMENTS if name not in FAST),
]
OWN = Questionnaire(
    "own",
    QUESTION_MOMENTS,
    (
        Item(
            "use",
            "How often did you use virtual reality before today?",
            3,
            "no",
            "yes",
            ("no", "some", "yes"),
        ),
        Item("pain", "How strong is it?", 11, "none", "worst", tuple(str(value) for value in range(11))),
    ),
)


def instrument_asked(name: str) -> Questionnaire:
    """An instrument at every moment, with words where its licence keeps them."""
    instrument = INSTRUMENTS[name]
    items = tuple(
        Item(
            item.id,
            item.text or "A statement that is as long as most of those that are in the source.",
            instrument.response_scale.option_count,
            item.low_label or "not at all",
            item.high_label or "completely",
            item.option_labels,
        )
        for item in instrument.items
    )
    return Questionnaire(name, QUESTION_MOMENTS, items, use=name)


def design_of(study: str) -> Design:
    design = parse_design(read_default_design_text())
    if study == "many policies":
        policies = ("original", "revised", "adaptive", "mine/a-policy-with-a-long-name")
        robots = ("PR2", "Jaco", "Sawyer", "Baxter")
        return msgspec.structs.replace(design, policies=policies, robots=robots)
    if study == "paper":
        return design
    asked = OWN if study == "own" else instrument_asked(study)
    return msgspec.structs.replace(design, questionnaires=(asked,))


def answers_of(design: Design) -> Iterator[AnswerRow]:
    """Answers of eight people by chance: after each trial with two tasks, before and after their session."""
    rng = np.random.default_rng(0)
    for questionnaire in design.questionnaires:
        trials = list(product(design.tasks[:2], design.robots, design.policies))
        for number, moment, item in product(range(PEOPLE), questionnaire.moments, questionnaire.items):
            scale = questionnaire.find_response_scale(item)
            for task, robot, policy in trials if moment == "after_trial" else [(None, None, None)]:
                yield AnswerRow(
                    participant=f"sub-{number:03}",
                    simulated=True,
                    counted=True,
                    session=1,
                    moment=moment,
                    questionnaire=questionnaire.name,
                    position=None,
                    task=task,
                    robot=robot,
                    policy=policy,
                    attempt=None,
                    item=item.id,
                    value=scale.compute_option_value(int(rng.integers(1, scale.option_count + 1))),
                    minimum=scale.lowest_value,
                    maximum=scale.highest_value,
                    points=scale.option_count,
                    response_time_s=1.0,
                    respondent="participant",
                )


def answer_drawings(design: Design) -> Iterator[ReportFigure]:
    answers = list(answers_of(design))
    families = [
        *compute_answer_test_families(design, answers),
        *compute_session_test_families(design, answers),
    ]
    tests = [row for family in families for row in family.rows]
    likert = [
        *make_answer_frequency_rows(design, answers),
        *make_session_answer_frequency_rows(design, answers),
    ]
    yield from draw_trial_answer_figures(design, True, likert, tests)
    yield from draw_session_answer_figures(design, True, likert, tests)
    yield from draw_mean_answer_figures(design, True, make_answer_summary_rows(design, answers), tests)


def outcome(task: str, robot: str, policy: str) -> ObjectiveOutcomeRow:
    return ObjectiveOutcomeRow(
        simulated=True, task=task, robot=robot, policy=policy, trials=PEOPLE, reward_mean=50.0, reward_low=-20.5,
        reward_high=120.0, successes=7, success_rate=0.875, success_low=0.5, success_high=0.98,
        simulation_population="revised", simulation_episodes=100, simulation_reward_mean=-90.0,
        simulation_reward_low=-100.0, simulation_reward_high=-80.0, simulation_success_rate=1.0,
        simulation_success_low=0.96, simulation_success_high=1.0,
    )  # fmt: skip


def objective_drawings(design: Design) -> Iterator[ReportFigure]:
    rows = [outcome(*each) for each in product(design.tasks, design.robots, design.policies)]
    yield draw_success_figure(design, True, rows)
    yield draw_reward_figure(design, True, rows)


def body_drawings(design: Design) -> Iterator[ReportFigure]:
    rng = np.random.default_rng(1)
    trials = [
        TrialRow(
            participant=f"sub-{number:03}", simulated=True, participant_state="completed",
            sex="woman" if number % 2 else "man", position=1, practice=False, task=task, robot="Jaco",
            policy="revised", seed=0, state="completed", attempts=1, attempts_not_completed=0, counted=True,
            torso_height_m=0.45 + 0.03 * number, head_x_m=float(rng.normal(0.0, 0.1)),
            head_y_m=float(rng.normal(0.0, 0.1)), head_z_m=float(rng.normal(1.1, 0.1)),
        )
        for number, task in product(range(PEOPLE), design.tasks)
    ]  # fmt: skip
    people = sample_training_populations(design)
    for group in group_posture_trials(trials):
        yield draw_torso_height_figure(group, people)
        yield draw_head_position_figure(group, people)


def flow_drawings() -> Iterator[ReportFigure]:
    excluded = {"Do you have a cognitive or visual impairment that glasses do not correct? Yes": 2}
    yield draw_flow_chart(
        ParticipantFlow(
            is_simulated=True, enrolled_participant_count=20, deleted_participant_count=1, without_consent_count=1,
            excluded_participant_count=2, early_withdrawal_count=1,
            awaiting_allocation_count=1,
            allocated_participant_count=14, late_withdrawal_count=2, unfinished_participant_count=3,
            completed_participant_count=9, analysed_participant_count=11, participants_by_order={1: 14},
            participants_by_consent_version={"1": 18},
            first_session_day=None, last_session_day=None, unfinished_analysed_participant_count=3,
            completed_unanalysed_participant_count=1,
            exclusions_by_answer=excluded,
            early_withdrawals_by_reason={"no reason stored": 1},
            late_withdrawals_by_reason={"felt sick in the headset": 2},
        )
    )  # fmt: skip


# Laws


def words_in(figure: Figure) -> dict[str, Bbox]:
    """The boxes of all words that a figure shows, in pixels; equal words are numbered."""
    canvas = FigureCanvasAgg(figure)
    figure.canvas.draw()
    found: dict[str, Bbox] = {}
    for axes in figure.axes:
        for axis, inside in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            for tick in axis.get_major_ticks():
                tick.label1.set_visible(axes.axison and min(inside) <= tick.get_loc() <= max(inside))
    for text in figure.findobj(Text):
        assert isinstance(text, Text)
        if text.get_visible() and text.get_text().strip():
            found[f"{text.get_text()} #{len(found)}"] = text.get_window_extent(canvas.get_renderer())
    return found


def faults(figure: Figure) -> list[str]:
    """What a reader could not read: axes without a label, words on words, words cut off."""
    found = [
        f"no label on {name}"
        for axes in figure.axes
        if axes.axison
        for name, label in (("x", axes.get_xlabel()), ("y", axes.get_ylabel()))
        if not label
    ]
    words = words_in(figure)
    for (first, a), (second, b) in combinations(words.items(), 2):
        across = min(a.x1, b.x1) - max(a.x0, b.x0)
        down = min(a.y1, b.y1) - max(a.y0, b.y0)
        if min(across, down) > SLACK_PX:
            found.append(f"{first!r} is on {second!r}")
    page = figure.bbox
    for text, box in words.items():
        if box.x0 < page.x0 or box.y0 < page.y0 or box.x1 > page.x1 or box.y1 > page.y1:
            found.append(f"{text!r} is cut off")
    return found


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("study", STUDIES)
def test_answers_are_shown_with_labelled_axes_and_words_that_can_be_read(study: str) -> None:
    drawings = list(answer_drawings(design_of(study)))
    assert drawings
    assert {each.name: faults(each.figure) for each in drawings} == {each.name: [] for each in drawings}


@pytest.mark.slow
@pytest.mark.parametrize("study", ["paper", "many policies"])
def test_objective_measures_and_bodies_are_shown_so_too(study: str) -> None:
    design = design_of(study)
    drawings = [*objective_drawings(design), *body_drawings(design), *flow_drawings()]
    assert {each.name: faults(each.figure) for each in drawings} == {each.name: [] for each in drawings}


def test_the_laws_find_words_on_words_words_cut_off_and_axes_without_labels() -> None:
    figure = Figure(figsize=(2, 2))
    axes = figure.add_subplot()
    axes.set(ylabel="height / m", xticks=[], yticks=[])
    axes.text(0.2, 0.5, "one word")
    axes.text(0.25, 0.5, "another")
    axes.text(0.9, 0.1, "that ends outside")
    assert [re.sub(r" #\d+", "", fault) for fault in faults(figure)] == [
        "no label on x",
        "'one word' is on 'another'",
        "'that ends outside' is cut off",
    ]


# PDF


@pytest.fixture(scope="module")
def drawing() -> ReportFigure:
    return next(objective_drawings(design_of("paper")))


def test_a_pdf_has_its_fonts_inside_and_no_date(drawing: ReportFigure) -> None:
    pdf = drawing.to_pdf()
    assert pdf.startswith(b"%PDF")
    described = pdf.count(b"/Type /FontDescriptor")
    assert described == pdf.count(b"/FontFile2 ") > 0
    assert b"/Type3" not in pdf
    assert b"/CreationDate" not in pdf
    size = [float(each) for each in re.findall(rb"/MediaBox \[([^\]]*)\]", pdf)[0].split()[2:]]
    shown = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', drawing.to_svg().decode())
    assert shown is not None
    assert size == [float(each) for each in shown.groups()]


def test_the_same_figure_gives_the_same_bytes(drawing: ReportFigure) -> None:
    again = next(objective_drawings(design_of("paper")))
    assert (again.to_svg(), again.to_pdf()) == (drawing.to_svg(), drawing.to_pdf())


@pytest.mark.slow
def test_the_same_figure_gives_the_same_bytes_in_another_process() -> None:
    code = (
        "import hashlib, test_figures as t;"
        "d = next(t.objective_drawings(t.design_of('paper')));"
        "print(hashlib.sha256(d.to_pdf() + d.to_svg()).hexdigest())"
    )
    shown = {
        subprocess.run(
            [sys.executable, "-c", code],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for seed in ("1", "2")
    }
    assert len(shown) == 1


def test_marks_of_episodes_of_another_length_are_named_so() -> None:
    design, note = design_of("paper"), "episodes have 200 steps, these trials 60"
    rows = [
        replace(outcome(*each), simulation_note=note)
        for each in product(design.tasks, design.robots, design.policies)
    ]
    drawing = draw_success_figure(design, True, rows)
    assert f"simulation: {note}" in drawing.to_svg().decode()
    assert faults(drawing.figure) == []
