"""The results of one group of participants on the page: objective, subjective, biomechanical."""

from collections.abc import Mapping, Sequence

from avrgym.analysis.figures.answer_figures import session_figure_name, trial_figure_name
from avrgym.analysis.figures.drawing import Drawing
from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.page import Markup, brief, figure, listing, quantity, table, tag
from avrgym.analysis.rows import ObjectiveRow, RangeRow, SessionAnswerRow, SubjectiveRow, TestedRow
from avrgym.analysis.statistics.biomechanics_tests import HEADS, HEIGHTS
from avrgym.analysis.statistics.families import TRIAL
from avrgym.analysis.statistics.objective import ALL
from avrgym.analysis.statistics.objective_tests import OBJECTIVE
from avrgym.analysis.statistics.paper_tables import PaperTable, paper_tables
from avrgym.analysis.statistics.session_answers import WORDS, about_sessions, change_question
from avrgym.analysis.statistics.subjective import AFTER_TRIAL, asked_at, policies_question
from avrgym.analysis.study import Analysis
from avrgym.questionnaires.questionnaire import SESSION_MOMENTS, Questionnaire

Drawings = Mapping[str, Drawing]
TestTables = dict[str, Markup]
"""Tables of tests by caption: each section takes its own out."""


def objective(analysis: Analysis, simulated: bool, drawings: Drawings, tests: TestTables) -> Markup:
    """Reward and success, as the paper's tables, then with intervals."""
    rows = [row for row in analysis.objective if row.simulated is simulated]
    if not rows:
        return _nothing("Objective measures", "No trial was completed yet.")
    return tag(
        "section",
        tag("h3", "Objective measures"),
        *(_paper_table(each) for each in paper_tables(analysis.design, rows)),
        _remarks(rows),
        _figures(drawings, "success", "reward"),
        _details("With 95 % intervals", _intervals(rows, simulated)),
        tests.pop(OBJECTIVE.table, Markup()),
    )


def _paper_table(shown: PaperTable) -> Markup:
    body = [
        (
            "Success over all tasks" if task == ALL else task,
            *(_reward(cell.reward, cell.success) for cell in cells),
        )
        for task, cells in shown.rows.items()
    ]
    caption = captioned(shown.caption, shown.simulated)
    return table(caption, ("Task", *shown.columns), body, numbers=range(1, len(shown.columns) + 1))


def _reward(mean: float | None, rate: float | None) -> str:
    if rate is None:
        return "–"
    share = f"{100 * rate:.0f} %"
    return share if mean is None else f"{quantity(mean, digits=0)} ({share})"


def _intervals(rows: Sequence[ObjectiveRow], simulated: bool) -> Markup:
    simulation = any(row.simulation_episodes for row in rows)
    heads = (
        "Task", "Robot", "Policy", "Trials", "Reward", "Success",
        *(("Simulated with", "Episodes", "Reward", "Success") if simulation else ()),
    )  # fmt: skip
    body = [
        (
            row.task, row.robot, row.policy, row.trials,
            _interval(row.reward_mean, row.reward_low, row.reward_high, row.trials),
            percent(row.success_rate, row.success_low, row.success_high),
            *(_simulation(row) if simulation else ()),
        )
        for row in rows
    ]  # fmt: skip
    numbers = (3, 4, 5, 7, 8, 9) if simulation else (3, 4, 5)
    return table(captioned("Objective measures with 95 % intervals", simulated), heads, body, numbers=numbers)


def _simulation(row: ObjectiveRow) -> tuple[object, ...]:
    """The cells about a condition in simulation."""
    return (
        row.simulation_people or "–",
        row.simulation_episodes or "–",
        _interval(
            row.simulation_reward_mean,
            row.simulation_reward_low,
            row.simulation_reward_high,
            row.simulation_episodes or 0,
        ),
        percent(row.simulation_success_rate, row.simulation_success_low, row.simulation_success_high),
    )


def _remarks(rows: Sequence[ObjectiveRow]) -> Markup:
    """What is to be said about simulation, each once, with the conditions that it is about."""
    about: dict[str, list[str]] = {}
    for row in rows:
        if row.simulation_note:
            about.setdefault(row.simulation_note, []).append(f"{row.task} {row.robot} {row.policy}")
    return listing([f"Simulation of {', '.join(which)}: {note}." for note, which in about.items()])


def _interval(mean: float | None, low: float | None, high: float | None, count: int) -> str:
    """The mean of so many values with its interval; several values without one are all equal."""
    if mean is None:
        return "–"
    without = " (all equal)" if count > 1 else ""
    ends = (
        without
        if low is None or high is None
        else f" [{quantity(low, digits=1)}, {quantity(high, digits=1)}]"
    )
    return quantity(mean, digits=1) + ends


def percent(rate: float | None, low: float | None, high: float | None) -> str:
    """A proportion with the ends of its interval, where it has one."""
    if rate is None:
        return "–"
    interval = "" if low is None or high is None else f" [{100 * low:.0f}, {100 * high:.0f}]"
    return f"{100 * rate:.0f} %{interval}"


# Answers


def answers(analysis: Analysis, simulated: bool, drawings: Drawings, tests: TestTables) -> Markup:
    """How participants answered each questionnaire after trials, with the paper's tests, then about sessions."""
    rated = [
        _after_trials(analysis, simulated, drawings, tests, questionnaire)
        for questionnaire in asked_at(analysis.design, AFTER_TRIAL)
    ]
    about = [
        _about_sessions(analysis, simulated, drawings, tests, questionnaire)
        for questionnaire in about_sessions(analysis.design)
    ]
    shown = [part for part in (*rated, *about) if part]
    if not shown:
        return _nothing("Answers", "No statement was rated yet.")
    return tag("section", tag("h3", "Answers"), *shown)


def _after_trials(
    analysis: Analysis,
    simulated: bool,
    drawings: Drawings,
    tests: TestTables,
    questionnaire: Questionnaire,
) -> Markup:
    items = [item.id for item in questionnaire.items]
    rows = [row for row in analysis.subjective if row.simulated is simulated and row.item in items]
    if not rows:
        return Markup()
    whole = [row for row in rows if (row.task, row.robot) == (ALL, ALL)]
    parts = [row for row in rows if (row.task, row.robot) != (ALL, ALL)]
    name = questionnaire.name
    return tag(
        "section",
        tag("h4", f"{name}, asked after each trial"),
        _statements(questionnaire),
        _figures(drawings, trial_figure_name(analysis.design, questionnaire)),
        _details(
            "Means, as in the paper's figure",
            _figures(drawings, f"{trial_figure_name(analysis.design, questionnaire)}-means"),
        ),
        _summaries(f"{name}: answers by policy, over all tasks and robots", whole, simulated),
        _details(
            "By task and robot", _summaries(f"{name}: answers by policy, task and robot", parts, simulated)
        ),
        tests.pop(policies_question(analysis.design, questionnaire).table, Markup()),
    )


def _about_sessions(
    analysis: Analysis,
    simulated: bool,
    drawings: Drawings,
    tests: TestTables,
    questionnaire: Questionnaire,
) -> Markup:
    rows = [
        row
        for row in analysis.session_answers
        if (row.simulated, row.questionnaire) == (simulated, questionnaire.name)
    ]
    if not rows:
        return Markup()
    name, when = questionnaire.name, " and ".join(WORDS[each] for each in _moments(questionnaire))
    heads = ("Item", "When", "n", "Median", "Quartiles", "Mean", "Range")
    body = [(row.item, WORDS[row.moment], *_quartiles(row)) for row in rows]
    caption = captioned(f"{name}: answers {when} sessions, one for each participant", simulated)
    return tag(
        "section",
        tag("h4", f"{name}, asked {when} sessions"),
        _statements(questionnaire),
        _figures(drawings, session_figure_name(questionnaire)),
        table(caption, heads, body, numbers=(2, 3, 4, 5, 6)),
        tests.pop(change_question(questionnaire).table, Markup()),
    )


def _moments(questionnaire: Questionnaire) -> list[str]:
    return [moment for moment in SESSION_MOMENTS if moment in questionnaire.moments]


def _statements(questionnaire: Questionnaire) -> Markup:
    """The items in their own words."""
    return listing(
        [f"{item.id}: {item.text} ({questionnaire.scale_words(item)})" for item in questionnaire.items]
    )


def _quartiles(row: SubjectiveRow | SessionAnswerRow) -> tuple[int, str, str, str, str]:
    """Number, median, quartiles, mean and range of answers, or of their changes."""
    return (
        row.n, _brief_number(row.median), f"{_brief_number(row.lower_quartile)} to {_brief_number(row.upper_quartile)}",
        quantity(row.mean), f"{_brief_number(row.least)} to {_brief_number(row.most)}",
    )  # fmt: skip


def _brief_number(value: float) -> str:
    """A number without needless digits."""
    return f"{value:g}".replace("-", "−")


def _summaries(caption: str, rows: Sequence[SubjectiveRow], simulated: bool) -> Markup:
    heads = ("Item", "Policy", "Task", "Robot", "Trials", "Median", "Quartiles", "Mean", "Range")
    body = [(row.item, row.policy, row.task, row.robot, *_quartiles(row)) for row in rows]
    return table(captioned(caption, simulated), heads, body, numbers=(4, 5, 6, 7, 8))


# Biomechanics


def biomechanics(analysis: Analysis, simulated: bool, drawings: Drawings, tests: TestTables) -> Markup:
    """Whether participants were like the people of the training, and which ranges would have covered them."""
    group = next((each for each in analysis.groups if each.simulated is simulated), None)
    if group is None:
        return _nothing("Biomechanics", "No counted trial has a whole recording of a body.")
    ranges = [row for row in analysis.ranges if row.simulated is simulated]
    return tag(
        "section",
        tag("h3", "Biomechanics: participants and the people of the training"),
        _figures(drawings, "torso-heights", "head-positions"),
        _ranges(ranges, simulated),
        tests.pop(HEIGHTS.table, Markup()),
        _details("Head positions, axis by axis", tests.pop(HEADS.table, Markup())),
        _details("The distributions in numbers", _distributions(analysis, simulated)),
    )


def _ranges(rows: Sequence[RangeRow], simulated: bool) -> Markup:
    heads = ("Measure", "n", "Seen", "Original", "covers", "Revised", "covers")
    body = [
        (
            row.quantity, row.n, _ends(row.least, row.most),
            _ends(row.original_low, row.original_high), f"{100 * row.original_covers:.0f} %",
            _ends(row.revised_low, row.revised_high), f"{100 * row.revised_covers:.0f} %",
        )
        for row in rows
    ]  # fmt: skip
    caption = (
        "What would have covered the participants, and what share of them the ranges of the training's people do: "
        "of participants for torso heights, of trials for waists"
    )
    return table(captioned(caption, simulated), heads, body, numbers=range(1, 7))


def _ends(low: float, high: float) -> str:
    return f"{brief(low)} to {brief(high)}"


def _distributions(analysis: Analysis, simulated: bool) -> Markup:
    heads = ("Measure", "Posture", "People", "n", "Mean", "Deviation", "Least", "Median", "Most")
    body = [
        (
            row.quantity, row.posture, row.people, row.n, quantity(row.mean, digits=3),
            quantity(row.deviation, digits=3, absent="–"),
            *(quantity(value, digits=3) for value in (row.least, row.median, row.most)),
        )
        for row in analysis.biomechanics
        if row.people != "participants" or row.simulated is simulated
    ]  # fmt: skip
    return table(
        captioned("Distributions; the training's people are simulated", simulated),
        heads,
        body,
        numbers=range(3, 9),
    )


# Tests


def tables_of_tests(analysis: Analysis, simulated: bool) -> TestTables:
    """The tests of every family of a group of participants, by the caption of the table that they stand in."""
    own = [family for family in analysis.families if family.simulated is simulated]
    rows = {
        caption: [row for family in own if family.question.table == caption for row in family.rows]
        for caption in dict.fromkeys(family.question.table for family in own)
    }
    return {caption: table_of_tests(caption, tests, simulated) for caption, tests in rows.items()}


def other_tests(tests: TestTables) -> Markup:
    """The tables that no section has taken."""
    return tag("section", tag("h3", "Other tests"), *tests.values()) if tests else Markup()


def table_of_tests(caption: str, rows: Sequence[TestedRow], simulated: bool) -> Markup:
    """Tests by participant as a table; those by trial follow in a supplement."""
    by_trial = [row for row in rows if row.unit == TRIAL]
    by_participant = [row for row in rows if row.unit != TRIAL]
    main = _table_of_tests(caption, by_participant, simulated) if by_participant else Markup()
    supplement = _table_of_tests(f"{caption}, by trial", by_trial, simulated)
    return Markup(main + _details(BY_TRIAL, supplement)) if by_trial else main


BY_TRIAL = (
    "Supplement: the paper's tests by trial. Trials of one participant are not independent, so p is too small where "
    "participants differ"
)


def _table_of_tests(caption: str, rows: Sequence[TestedRow], simulated: bool) -> Markup:
    """Tests as a table, with what they are by the study's plan if there is one."""
    planned, corrected = any(row.planned for row in rows), any(row.p_primary is not None for row in rows)
    heads = (
        "What", "Groups", "Unit", "n", "Medians", "p", "p, Holm", *(["p, corrected"] if corrected else []),
        "Effect [95 %]", "Test", "Role", *(["By plan"] if planned else []),
    )  # fmt: skip
    body = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.unit,
            values_given(row),
            f"{brief(row.median_a)} / {brief(row.median_b)}",
            probability(row.p), probability(row.p_holm), *([over_primary(row)] if corrected else []),
            with_interval(row.effect, row.effect_low, row.effect_high),
            f"{row.test}, {row.note or row.method}", row.role, *([row.planned] if planned else []),
        )
        for row in rows
    ]  # fmt: skip
    return table(captioned(caption, simulated), heads, body, numbers=range(3, 9 if corrected else 8))


def over_primary(row: TestedRow | ModelRow) -> str:
    """p corrected over all primary results; nothing for other results."""
    return "–" if row.p_primary is None else probability(row.p_primary)


def with_interval(effect: float | None, low: float | None, high: float | None) -> str:
    """An effect size with the ends of its 95 % interval, where it has one."""
    ends = "" if low is None or high is None else f" [{quantity(low)}, {quantity(high)}]"
    return quantity(effect, absent="–") + ends


def values_given(row: TestedRow) -> str:
    """The number of values in a test, by group if they are not pairs, and the number of equal pairs."""
    if row.n_a != row.n_b:
        return f"{row.n_a} / {row.n_b}"
    return f"{row.n} + {row.zeros} zero" if row.zeros else str(row.n)


def probability(p: float | None) -> str:
    """A probability for people."""
    if p is None:
        return "no test"
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


# Parts


def _figures(drawings: Drawings, *kinds: str) -> Markup:
    present = [drawings[kind] for kind in kinds if kind in drawings]
    shown = [figure(tag("div", each.inline(), class_="scroll", tabindex=0), each.caption) for each in present]
    return tag("div", *shown, class_="figures")


def _details(summary: str, *content: Markup) -> Markup:
    return tag("details", tag("summary", summary), *content)


def _nothing(title: str, text: str) -> Markup:
    return tag("section", tag("h3", title), tag("p", text))


def captioned(caption: str, simulated: bool) -> str:
    """A caption that says where it is about simulated participants."""
    return f"{caption} (simulated participants)" if simulated else caption
