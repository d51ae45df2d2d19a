"""Report of a study: results of people, then of simulated participants, with a section for each topic."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from avrgym.analysis.access_log import render_access_log_section
from avrgym.analysis.adverse_events import render_adverse_events_section
from avrgym.analysis.answers.scores import render_scores_section
from avrgym.analysis.answers.section import render_answers_section
from avrgym.analysis.biomechanics.section import render_biomechanics_section
from avrgym.analysis.biomechanics.training_populations import SAMPLED_PEOPLE_PER_TASK
from avrgym.analysis.commands import COMMANDS_METHOD_TEXT, render_commands_section
from avrgym.analysis.designs import (
    DESIGN_DIFFERENCES_TITLE,
    describe_session_designs,
    render_design_differences_notice,
    render_design_differences_section,
)
from avrgym.analysis.headsets import render_headset_section
from avrgym.analysis.latency import LATENCY_METHOD_TEXT, render_latency_section
from avrgym.analysis.models.section import MODELS_METHOD_TEXT, render_models_section
from avrgym.analysis.outcomes.section import render_outcomes_section
from avrgym.analysis.outcomes.trials_section import render_trials_section
from avrgym.analysis.page.html_elements import (
    Markup,
    format_count,
    format_group_caption,
    join_markup,
    render_badge,
    render_bullet_list,
    render_definition_list,
    render_table,
    render_warning_box,
    tag,
    write_html_page,
)
from avrgym.analysis.page.hypothesis_test_tables import (
    render_hypothesis_test_tables,
    render_other_tests_section,
)
from avrgym.analysis.page.report_figures import ReportFigure
from avrgym.analysis.plan import NO_PLAN_TEXT, render_confirmatory_section, render_plan_section
from avrgym.analysis.primary_results import render_primary_section
from avrgym.analysis.reading.table_rows import ParticipantRow
from avrgym.analysis.repeated_trials import REPEATS_METHOD_TEXT, render_repeated_trials_section
from avrgym.analysis.sessions import render_sessions_section
from avrgym.analysis.sites import render_sites_section
from avrgym.analysis.statistics.rank_tests import MAX_EXACT_SIGNED_RANK_N
from avrgym.analysis.streams import render_streams_section
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.study.design.design import Design
from avrgym.study.storage.state_transitions import UNKNOWN_PARTICIPATION_STATE
from avrgym.system.random_streams import TRAINING_POPULATION_SEED

GROUP_TITLES = {False: "People", True: "Simulated participants"}


def write_report(
    path: Path, analysis: StudyAnalysis, drawings: Sequence[ReportFigure], study_link: str
) -> None:
    """Write the report as an HTML page. Equal analyses result in equal bytes.

    ``study_link``: relative link to the study's folder.
    """
    groups = sorted({row.simulated for row in analysis.study_data.participants})
    header = [
        tag("p", "Analysis of the study in its current state."),
        _notices(analysis),
        _navigation(analysis, groups),
    ]
    sections = [_group(analysis, simulated, drawings, study_link) for simulated in groups]
    nobody = [tag("p", "There are no participants yet.")] if not groups else []
    write_html_page(
        path,
        analysis.design.title,
        header,
        [
            render_design_differences_section(analysis.design_differences, analysis.item_versions),
            render_plan_section(analysis.plan_with_deviations),
            *nobody,
            *sections,
            _facts(analysis),
            render_access_log_section(analysis.access_log, analysis.database_rebuilt_at),
            _problems(analysis),
            _methods(analysis),
        ],
    )


def _notices(analysis: StudyAnalysis) -> Markup:
    everyone = analysis.study_data.participants
    notices: list[Markup] = render_design_differences_notice(analysis.design_differences)
    simulated = sum(row.simulated for row in everyone)
    if simulated:
        which = "All" if simulated == len(everyone) else f"{simulated} of the {len(everyone)}"
        words = (
            f"{which} participants are simulated: a program generated their poses and answers. They contain no "
            "information about people and are analysed separately."
        )
        notices.append(render_warning_box("SIMULATED PARTICIPANTS.", words))
    by_proxy = [row for row in analysis.study_data.answers if row.respondent == PROXY_RESPONDENT]
    if by_proxy:
        people = len({row.participant for row in by_proxy})
        words = (
            f"A proxy gave {len(by_proxy)} of {len(analysis.study_data.answers)} answers, for "
            f"{format_count(people, 'participant')}. Tables count them in a column; tests and models contain them."
        )
        notices.append(render_warning_box("Answers by proxy.", words))
    notices += [render_warning_box("Rebuilt database.", words) for words in analysis.data_losses]
    if analysis.plan_with_deviations is not None and not analysis.plan_with_deviations.is_confirmatory:
        notices.append(render_warning_box("Exploratory.", "No plan was frozen before the first participant."))
    if (
        any(use.design.blind_experimenter for use in analysis.session_designs)
        or analysis.design.blind_experimenter
    ):
        notices.append(
            render_warning_box(
                "Unblinded.", "The experimenter is blinded in this study; this page names the policies."
            )
        )
    return join_markup(notices)


def _navigation(analysis: StudyAnalysis, groups: Sequence[bool]) -> Markup:
    plan = [tag("a", DESIGN_DIFFERENCES_TITLE, href="#differences")] if analysis.design_differences else []
    plan += [tag("a", "The plan", href="#plan")] if analysis.plan_with_deviations else []
    links = [tag("a", GROUP_TITLES[simulated], href=f"#{_id(simulated)}") for simulated in groups]
    return tag(
        "nav",
        *plan,
        *links,
        tag("a", "About the study", href="#facts"),
        tag("a", "The log", href="#log"),
        tag("a", "Problems", href="#problems"),
        tag("a", "Methods", href="#methods"),
    )


def _id(simulated: bool) -> str:
    return "simulated" if simulated else "people"


def _group(
    analysis: StudyAnalysis, simulated: bool, drawings: Sequence[ReportFigure], study_link: str
) -> Markup:
    own = {
        each.name.rpartition("-")[0]: each
        for each in drawings
        if each.name.rpartition("-")[2] == _id(simulated)
    }
    mark = [render_badge("SIMULATED PARTICIPANTS")] if simulated else []
    tests = render_hypothesis_test_tables(analysis.test_families, simulated)
    design, observed = analysis.design, analysis.study_data
    confirmed = analysis.plan_with_deviations.confirmatory_plan if analysis.plan_with_deviations else None
    findings = analysis.repeat_findings if simulated is analysis.are_repeats_simulated else []
    return tag(
        "article",
        tag("h2", GROUP_TITLES[simulated]),
        *mark,
        _counts(analysis, simulated),
        render_sessions_section(analysis.sessions, simulated),
        render_confirmatory_section(confirmed, analysis.tests, analysis.model_effects, simulated),
        render_primary_section(
            analysis.tests, analysis.model_effects, simulated, planned=confirmed is not None
        ),
        render_outcomes_section(design, analysis.objective_outcomes, simulated, own, tests),
        render_answers_section(
            design, analysis.answer_summaries, analysis.session_answers, simulated, own, tests
        ),
        render_scores_section(design, observed.scores, analysis.score_summaries, simulated, tests),
        render_models_section(analysis.model_effects, simulated),
        render_commands_section(design, observed.trials, observed.commands, simulated),
        render_biomechanics_section(
            analysis.biomechanics_rows, analysis.measure_ranges, simulated, own, tests
        ),
        render_other_tests_section(tests),
        render_sites_section(
            observed.participants, observed.trials, analysis.site_outcomes, analysis.site_effects, simulated
        ),
        *([] if simulated else [render_adverse_events_section(analysis)]),
        render_streams_section(observed.streams, simulated),
        render_latency_section(analysis.latency_summaries, simulated),
        render_repeated_trials_section(design, analysis.repeated_trials, findings, simulated),
        render_trials_section(observed, simulated, study_link),
        id=_id(simulated),
    )


def _counts(analysis: StudyAnalysis, simulated: bool) -> Markup:
    people = [row for row in analysis.study_data.participants if row.simulated is simulated]
    trials = [row for row in analysis.study_data.trials if row.simulated is simulated]
    unknown = _in_state(people, UNKNOWN_PARTICIPATION_STATE)
    metrics = {
        "Participants": len(people),
        "completed the study": _in_state(people, "completed"),
        "withdrew": _in_state(people, "withdrawn"),
        "excluded": _in_state(people, "excluded"),
        **({"consent unknown": unknown} if unknown else {}),
        "Trials planned": len(trials),
        "of them practice": sum(row.practice for row in trials),
        "Trials completed": sum(row.state == "completed" for row in trials),
        "missing": sum(row.state != "completed" for row in trials),
        "in the analyses": sum(row.counted for row in trials),
        "excluded, tracking lost": sum(row.left_out is not None for row in trials),
        "Attempts": sum(row.attempts for row in trials),
        "not completed": sum(row.attempts_not_completed for row in trials),
    }
    sites = ["Site"] if any(row.site for row in people) else []
    rows = [
        (
            row.participant, *([row.site or ""] if sites else []), row.state, row.sex, row.language,
            "" if row.age_years is None else row.age_years,
            "" if row.torso_height_m is None else f"{row.torso_height_m:.3f}", row.sessions,
            row.trials_completed, row.trials_missing, row.attempts, row.attempts_not_completed,
        )
        for row in people
    ]  # fmt: skip
    heads = (
        "Participant", *sites, "State", "Body", "Language", "Age", "Torso / m", "Sessions", "Trials completed",
        "missing", "Attempts", "not completed",
    )  # fmt: skip
    also = " or whose consent is unknown" if unknown else ""
    caption = f"Participants, including those who withdrew{also}, who are in no analysis"
    left_out = [f"{row.participant}, trial {row.position}: {row.left_out}." for row in trials if row.left_out]
    listed = [tag("p", "Excluded from the analyses:"), render_bullet_list(left_out)] if left_out else []
    shown = render_table(
        format_group_caption(caption, simulated), heads, rows, numbers=range(len(heads) - 7, len(heads))
    )
    return join_markup([render_definition_list(metrics), *listed, shown])


def _in_state(people: Sequence[ParticipantRow], state: str) -> int:
    return sum(row.state == state for row in people)


def _facts(analysis: StudyAnalysis) -> Markup:
    """Returns a section with facts for a publication that ``results.json`` does not contain."""
    design, session_designs = analysis.design, analysis.session_designs
    given = {
        name.replace("_", " ").capitalize(): text or "missing; set it in [reporting] of study.toml"
        for name, text in msgspec.structs.asdict(design.reporting).items()
    }
    rows = given | {
        "Task text for participants": describe_session_designs(session_designs, design, _goals),
        "Real seat": describe_session_designs(session_designs, design, _seat),
        "Real mattress": describe_session_designs(session_designs, design, _mattress),
    }
    words = render_bullet_list([f"{name}: {text}" for name, text in rows.items()])
    note = "Values come from recordings if there are any."
    planned = [] if analysis.plan_with_deviations else [tag("p", NO_PLAN_TEXT)]
    return tag("section", tag("h2", "About the study"), words, tag("p", note), *planned, id="facts")


def _goals(design: Design) -> str:
    return " ".join(f"{task}: {design.find_task_instruction(task)}" for task in design.tasks)


def _seat(design: Design) -> str:
    return design.furniture.describe(seated=True)


def _mattress(design: Design) -> str:
    return design.furniture.describe(seated=False)


def _problems(analysis: StudyAnalysis) -> Markup:
    places: dict[tuple[str, str], list[str]] = {}
    for row in analysis.study_data.problems:
        places.setdefault((row.what, row.consequence), []).append(row.where)
    lines = [_problem(what, consequence, where) for (what, consequence), where in places.items()]
    text = (
        format_count(len(analysis.study_data.problems), "problem") + ":"
        if lines
        else "None: every recording is present, complete and consistent."
    )
    body = [tag("p", text), render_bullet_list(lines)] if lines else [tag("p", text)]
    return tag("section", tag("h2", "Problems"), *body, id="problems")


def _problem(what: str, consequence: str, where: Sequence[str]) -> Markup:
    """Returns one data problem with all its places, such as trials. Several places are shown as a folded list."""
    if len(where) == 1:
        return tag("span", f"{where[0]} {what}: {consequence}.")
    return tag(
        "details", tag("summary", f"{len(where)} times: {what}: {consequence}."), render_bullet_list(where)
    )


METHOD_TEXTS = (
    "Analysed trials: completed trials without practice, of participants who have not withdrawn. A trial is excluded "
    "and listed if tracking was lost or jumped for a larger share of the robot's time than the design allows. Every "
    "table in tables/ marks rows about simulated participants.",
    "Reward: mean over participants with a 95 % confidence interval (Student's t). Success: Wilson's 95 % confidence "
    "interval, with the effective sample size if participants have several trials. Next to them is the evaluation of "
    "the same policy in simulation with its training population. Rewards that are all equal have no interval.",
    "Wilcoxon signed-rank test: zero differences are omitted and ties get mean ranks. It is exact for at most "
    f"{MAX_EXACT_SIGNED_RANK_N} differences, else a normal approximation. Policies are paired within participant × "
    "task × robot. Tests by participant use the mean of each participant's trials. Tests by trial repeat the paper's "
    "analysis, which assumes independent trials.",
    "Effect size: rank-biserial correlation r from −1 to 1, positive if the first group is larger. Its 95 % confidence "
    "interval is Wilson's for the share (1 + r) / 2, with the effective sample size of the ranks. For energy distances "
    "the effect size is the share of the distance between the groups, from 0 to 1. Holm's correction is within a "
    "family: one question and one unit of analysis.",
    "Primary results: p is corrected over all of them by a step-down sign-flip permutation test, which flips all "
    "differences of a participant together (Westfall and Young, 1993; Romano and Wolf, 2005). Models and unpaired "
    "tests that a plan makes primary have Holm's correction. If a plan has both, each corrected p is doubled.",
    f"Training populations: {SAMPLED_PEOPLE_PER_TASK} people sampled for each task and population, seed "
    f"{TRAINING_POPULATION_SEED}.",
    "Head positions and torso heights: signed-rank tests pair each trial with a sampled person, as in the paper. "
    "Mann-Whitney and energy distance tests compare one value per participant with all sampled people. Means of "
    "several trials vary less than single people, so a small p does not always mean another location.",
)


def _methods(analysis: StudyAnalysis) -> Markup:
    more = (
        "docs/reference/analysis.md in AVR Gym's repository describes the tables and how to recompute numbers. "
        "reporting/index.html contains text, tables and a checklist for a publication."
    )
    commands = (COMMANDS_METHOD_TEXT,) if analysis.study_data.commands else ()
    return tag(
        "section",
        tag("h2", "Methods"),
        render_bullet_list(
            (*METHOD_TEXTS, *MODELS_METHOD_TEXT, *commands, REPEATS_METHOD_TEXT, LATENCY_METHOD_TEXT)
        ),
        render_headset_section(analysis.headset_checks),
        tag("p", more),
        id="methods",
    )
