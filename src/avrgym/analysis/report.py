"""Report of a study: results of people, then of simulated participants, with a section for each topic."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from avrgym.analysis.adverse_events import adverse_events_section
from avrgym.analysis.answers.scores import scores_section
from avrgym.analysis.answers.section import answers_section
from avrgym.analysis.biomechanics.section import biomechanics_section
from avrgym.analysis.biomechanics.training_people import PEOPLE_PER_TASK
from avrgym.analysis.commands import COMMANDS_METHOD_TEXT, commands_section
from avrgym.analysis.designs import (
    DESIGN_DIFFERENCES_TITLE,
    describe_by_design,
    design_differences_notice,
    design_differences_section,
)
from avrgym.analysis.headsets import headset_section
from avrgym.analysis.latency import LATENCY_METHOD_TEXT, latency_section
from avrgym.analysis.log import access_log_section
from avrgym.analysis.models.section import MODELS_METHOD_TEXT, models_section
from avrgym.analysis.outcomes.section import outcomes_section
from avrgym.analysis.outcomes.trials import trials_section
from avrgym.analysis.page.comparisons import hypothesis_test_tables, other_tests_section
from avrgym.analysis.page.drawing import ReportFigure
from avrgym.analysis.page.elements import (
    Markup,
    badge,
    bullet_list,
    count_text,
    definition_list,
    group_caption,
    join_markup,
    table,
    tag,
    warning_box,
    write_html_page,
)
from avrgym.analysis.plan import NO_PLAN_TEXT, confirmatory_section, plan_section
from avrgym.analysis.primary import primary_section
from avrgym.analysis.reading.rows import ParticipantRow
from avrgym.analysis.repeats import REPEATS_METHOD_TEXT, repeats_section
from avrgym.analysis.sessions import sessions_section
from avrgym.analysis.sites import sites_section
from avrgym.analysis.statistics.tests import MAX_EXACT_SIGNED_RANK_N
from avrgym.analysis.streams import streams_section
from avrgym.analysis.study import StudyAnalysis
from avrgym.commands.respondents import PROXY
from avrgym.study.design.design import Design
from avrgym.study.storage.states import UNKNOWN_PARTICIPATION
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
            design_differences_section(analysis.design_differences, analysis.item_versions),
            plan_section(analysis.frozen_plan),
            *nobody,
            *sections,
            _facts(analysis),
            access_log_section(analysis.access_log, analysis.rebuilt_at),
            _problems(analysis),
            _methods(analysis),
        ],
    )


def _notices(analysis: StudyAnalysis) -> Markup:
    everyone = analysis.study_data.participants
    notices: list[Markup] = design_differences_notice(analysis.design_differences)
    simulated = sum(row.simulated for row in everyone)
    if simulated:
        which = "All" if simulated == len(everyone) else f"{simulated} of the {len(everyone)}"
        words = (
            f"{which} participants are simulated: a program generated their poses and answers. They contain no "
            "information about people and are analysed separately."
        )
        notices.append(warning_box("SIMULATED PARTICIPANTS.", words))
    by_proxy = [row for row in analysis.study_data.answers if row.respondent == PROXY]
    if by_proxy:
        people = len({row.participant for row in by_proxy})
        words = (
            f"A proxy gave {len(by_proxy)} of {len(analysis.study_data.answers)} answers, for "
            f"{count_text(people, 'participant')}. Tables count them in a column; tests and models contain them."
        )
        notices.append(warning_box("Answers by proxy.", words))
    notices += [warning_box("Rebuilt database.", words) for words in analysis.data_losses]
    if analysis.frozen_plan is not None and not analysis.frozen_plan.is_confirmatory:
        notices.append(warning_box("Exploratory.", "No plan was frozen before the first participant."))
    if (
        any(use.design.blind_experimenter for use in analysis.session_designs)
        or analysis.design.blind_experimenter
    ):
        notices.append(
            warning_box(
                "Unblinded.", "The experimenter is blinded in this study; this page names the policies."
            )
        )
    return join_markup(notices)


def _navigation(analysis: StudyAnalysis, groups: Sequence[bool]) -> Markup:
    plan = [tag("a", DESIGN_DIFFERENCES_TITLE, href="#differences")] if analysis.design_differences else []
    plan += [tag("a", "The plan", href="#plan")] if analysis.frozen_plan else []
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
    mark = [badge("SIMULATED PARTICIPANTS")] if simulated else []
    tests = hypothesis_test_tables(analysis.families, simulated)
    design, observed = analysis.design, analysis.study_data
    confirmed = analysis.frozen_plan.confirmatory_plan if analysis.frozen_plan else None
    findings = analysis.repeat_findings if simulated is analysis.repeats_of_simulated else []
    return tag(
        "article",
        tag("h2", GROUP_TITLES[simulated]),
        *mark,
        _counts(analysis, simulated),
        sessions_section(analysis.sessions, simulated),
        confirmatory_section(confirmed, analysis.tests, analysis.models, simulated),
        primary_section(analysis.tests, analysis.models, simulated, planned=confirmed is not None),
        outcomes_section(design, analysis.objective_outcomes, simulated, own, tests),
        answers_section(design, analysis.answer_summaries, analysis.session_answers, simulated, own, tests),
        scores_section(design, observed.scores, analysis.score_summaries, simulated, tests),
        models_section(analysis.models, simulated),
        commands_section(design, observed.trials, observed.commands, simulated),
        biomechanics_section(analysis.biomechanics, analysis.measure_ranges, simulated, own, tests),
        other_tests_section(tests),
        sites_section(
            observed.participants, observed.trials, analysis.site_outcomes, analysis.site_effects, simulated
        ),
        *([] if simulated else [adverse_events_section(analysis)]),
        streams_section(observed.streams, simulated),
        latency_section(analysis.latency_summaries, simulated),
        repeats_section(design, analysis.repeats, findings, simulated),
        trials_section(observed, simulated, study_link),
        id=_id(simulated),
    )


def _counts(analysis: StudyAnalysis, simulated: bool) -> Markup:
    people = [row for row in analysis.study_data.participants if row.simulated is simulated]
    trials = [row for row in analysis.study_data.trials if row.simulated is simulated]
    unknown = _in_state(people, UNKNOWN_PARTICIPATION)
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
    listed = [tag("p", "Excluded from the analyses:"), bullet_list(left_out)] if left_out else []
    shown = table(group_caption(caption, simulated), heads, rows, numbers=range(len(heads) - 7, len(heads)))
    return join_markup([definition_list(metrics), *listed, shown])


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
        "Task text for participants": describe_by_design(session_designs, design, _goals),
        "Real seat": describe_by_design(session_designs, design, _seat),
        "Real mattress": describe_by_design(session_designs, design, _mattress),
    }
    words = bullet_list([f"{name}: {text}" for name, text in rows.items()])
    note = "Values come from recordings if there are any."
    planned = [] if analysis.frozen_plan else [tag("p", NO_PLAN_TEXT)]
    return tag("section", tag("h2", "About the study"), words, tag("p", note), *planned, id="facts")


def _goals(design: Design) -> str:
    return " ".join(f"{task}: {design.instruction_of_task(task)}" for task in design.tasks)


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
        count_text(len(analysis.study_data.problems), "problem") + ":"
        if lines
        else "None: every recording is present, complete and consistent."
    )
    body = [tag("p", text), bullet_list(lines)] if lines else [tag("p", text)]
    return tag("section", tag("h2", "Problems"), *body, id="problems")


def _problem(what: str, consequence: str, where: Sequence[str]) -> Markup:
    """Returns one data problem with all its places, such as trials. Several places are shown as a folded list."""
    if len(where) == 1:
        return tag("span", f"{where[0]} {what}: {consequence}.")
    return tag("details", tag("summary", f"{len(where)} times: {what}: {consequence}."), bullet_list(where))


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
    f"Training populations: {PEOPLE_PER_TASK} people sampled for each task and population, seed "
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
        bullet_list(
            (*METHOD_TEXTS, *MODELS_METHOD_TEXT, *commands, REPEATS_METHOD_TEXT, LATENCY_METHOD_TEXT)
        ),
        headset_section(analysis.headset_checks),
        tag("p", more),
        id="methods",
    )
