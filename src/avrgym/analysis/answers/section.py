"""Report section with the answers to questionnaires."""

from collections.abc import Sequence

from avrgym.analysis.answers.figures import make_session_answer_figure_name, make_trial_answer_figure_name
from avrgym.analysis.answers.session_answers import (
    CHANGE_LABEL,
    MOMENT_LABELS,
    SessionAnswerSummaryRow,
    find_repeatable_questionnaires,
    find_session_questionnaires,
    make_session_change_question,
)
from avrgym.analysis.answers.trial_answers import (
    AFTER_TRIAL,
    AnswerSummaryRow,
    find_questionnaires_at_moment,
    make_policy_comparison_question,
)
from avrgym.analysis.page.html_elements import (
    Markup,
    format_group_caption,
    format_number,
    render_bullet_list,
    render_details,
    render_empty_section,
    render_table,
    tag,
)
from avrgym.analysis.page.hypothesis_test_tables import TestTables
from avrgym.analysis.page.report_figures import ReportFiguresByKind, render_inline_figures
from avrgym.analysis.reading.table_rows import ALL_LABEL
from avrgym.questionnaires.questionnaire import SESSION_QUESTION_MOMENTS, Questionnaire
from avrgym.study.design.design import Design

# Answers


def render_answers_section(
    design: Design,
    after_trials: Sequence[AnswerSummaryRow],
    about_sessions: Sequence[SessionAnswerSummaryRow],
    simulated: bool,
    drawings: ReportFiguresByKind,
    tests: TestTables,
) -> Markup:
    """Returns the report section: answers after trials and about sessions, both with tests, then further answers."""
    rated = [
        _after_trials(design, after_trials, simulated, drawings, tests, questionnaire)
        for questionnaire in find_questionnaires_at_moment(design, AFTER_TRIAL)
    ]
    about = [
        _about_sessions(about_sessions, simulated, drawings, tests, questionnaire)
        for questionnaire in find_session_questionnaires(design)
    ]
    further = [
        _further(about_sessions, simulated, questionnaire, moment)
        for questionnaire, moment in find_repeatable_questionnaires(design)
    ]
    shown = [part for part in (*rated, *about, *further) if part]
    if not shown:
        return render_empty_section("Answers", "No questionnaire item was answered yet.")
    return tag("section", tag("h3", "Answers"), *shown)


def _after_trials(
    design: Design,
    answers: Sequence[AnswerSummaryRow],
    simulated: bool,
    drawings: ReportFiguresByKind,
    tests: TestTables,
    questionnaire: Questionnaire,
) -> Markup:
    items = [item.id for item in questionnaire.items]
    rows = [row for row in answers if row.simulated is simulated and row.item in items]
    if not rows:
        return Markup()
    whole = [row for row in rows if (row.task, row.robot) == (ALL_LABEL, ALL_LABEL)]
    parts = [row for row in rows if (row.task, row.robot) != (ALL_LABEL, ALL_LABEL)]
    name = questionnaire.name
    return tag(
        "section",
        tag("h4", f"{name}, asked after each trial"),
        _statements(questionnaire),
        render_inline_figures(drawings, make_trial_answer_figure_name(design, questionnaire)),
        render_details(
            "Means, as in the paper's figure",
            render_inline_figures(drawings, f"{make_trial_answer_figure_name(design, questionnaire)}-means"),
        ),
        _summaries(f"{name}: answers by policy, over all tasks and robots", whole, simulated),
        render_details(
            "By task and robot", _summaries(f"{name}: answers by policy, task and robot", parts, simulated)
        ),
        tests.pop(make_policy_comparison_question(design, questionnaire).table_caption, Markup()),
    )


def _about_sessions(
    answers: Sequence[SessionAnswerSummaryRow],
    simulated: bool,
    drawings: ReportFiguresByKind,
    tests: TestTables,
    questionnaire: Questionnaire,
) -> Markup:
    rows = [
        row
        for row in answers
        if (row.simulated, row.questionnaire) == (simulated, questionnaire.name)
        and row.moment in (*SESSION_QUESTION_MOMENTS, CHANGE_LABEL)
    ]
    if not rows:
        return Markup()
    name, when = questionnaire.name, " and ".join(MOMENT_LABELS[each] for each in _moments(questionnaire))
    heads = ("Item", "When", "n", "Proxy", "Median", "Quartiles", "Mean", "Range")
    body = [(row.item, MOMENT_LABELS[row.moment], *_quartiles(row)) for row in rows]
    caption = format_group_caption(f"{name}: answers {when} sessions, one for each participant", simulated)
    return tag(
        "section",
        tag("h4", f"{name}, asked {when} sessions"),
        _statements(questionnaire),
        render_inline_figures(drawings, make_session_answer_figure_name(questionnaire)),
        render_table(caption, heads, body, numbers=(2, 3, 4, 5, 6, 7)),
        tests.pop(make_session_change_question(questionnaire).table_caption, Markup()),
    )


def _further(
    answers: Sequence[SessionAnswerSummaryRow], simulated: bool, questionnaire: Questionnaire, moment: str
) -> Markup:
    """Returns a summary of the answers after breaks, or of the answers of caregivers. It contains no tests."""
    wanted = (simulated, questionnaire.name, moment)
    rows = [row for row in answers if (row.simulated, row.questionnaire, row.moment) == wanted]
    if not rows:
        return Markup()
    title = f"{questionnaire.name}, {_FURTHER_TITLES[moment]}"
    heads = ("Item", "n", "Proxy", "Median", "Quartiles", "Mean", "Range")
    body = [(row.item, *_quartiles(row)) for row in rows]
    caption = format_group_caption(f"{title}: mean answer for each participant", simulated)
    return tag(
        "section",
        tag("h4", title),
        _statements(questionnaire),
        render_table(caption, heads, body, numbers=(1, 2, 3, 4, 5, 6)),
    )


_FURTHER_TITLES = {"after_break": "asked after breaks", "caregiver": "answered by caregivers for themselves"}


def _moments(questionnaire: Questionnaire) -> list[str]:
    return [moment for moment in SESSION_QUESTION_MOMENTS if moment in questionnaire.moments]


def _statements(questionnaire: Questionnaire) -> Markup:
    """Returns a bullet list of the items' texts and response scales."""
    return render_bullet_list(
        [
            f"{item.id}: {item.text} ({questionnaire.describe_response_scale(item)})"
            for item in questionnaire.items
        ]
    )


def _quartiles(row: AnswerSummaryRow | SessionAnswerSummaryRow) -> tuple[int, int, str, str, str, str]:
    """Returns number of answers, number of answers by a proxy, median, quartiles, mean and range as table cells."""
    return (
        row.n, row.by_proxy, _brief_number(row.median),
        f"{_brief_number(row.lower_quartile)} to {_brief_number(row.upper_quartile)}",
        format_number(row.mean), f"{_brief_number(row.minimum)} to {_brief_number(row.maximum)}",
    )  # fmt: skip


def _brief_number(value: float) -> str:
    """Returns the number as text without trailing zeros, such as "2.5"."""
    return f"{value:g}".replace("-", "−")


def _summaries(caption: str, rows: Sequence[AnswerSummaryRow], simulated: bool) -> Markup:
    heads = ("Item", "Policy", "Task", "Robot", "Trials", "Proxy", "Median", "Quartiles", "Mean", "Range")
    body = [(row.item, row.policy, row.task, row.robot, *_quartiles(row)) for row in rows]
    return render_table(format_group_caption(caption, simulated), heads, body, numbers=(4, 5, 6, 7, 8, 9))
