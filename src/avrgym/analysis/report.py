"""The report of a study: people first, then simulated participants, each with a section for each topic."""

from collections.abc import Sequence
from pathlib import Path

import msgspec

from avrgym.analysis.adverse_events import adverse_events_section
from avrgym.analysis.answers.scores import scores_section
from avrgym.analysis.answers.section import answers_section
from avrgym.analysis.biomechanics.section import biomechanics_section
from avrgym.analysis.biomechanics.training_people import PEOPLE_PER_TASK
from avrgym.analysis.designs import (
    DIFFERENCES_TITLE,
    describe_by_design,
    differences_notice,
    differences_section,
)
from avrgym.analysis.headsets import headset_section
from avrgym.analysis.latency import LATENCY_METHOD, latency_section
from avrgym.analysis.log import log_section
from avrgym.analysis.models.section import MODELS_METHOD, models_section
from avrgym.analysis.outcomes.section import outcomes_section
from avrgym.analysis.outcomes.trials import trials_section
from avrgym.analysis.page.comparisons import other_tests, tables_of_tests
from avrgym.analysis.page.drawing import Drawing
from avrgym.analysis.page.elements import (
    Markup,
    badge,
    bullet_list,
    count_text,
    definition_list,
    group_caption,
    join,
    table,
    tag,
    warning_box,
    write_page,
)
from avrgym.analysis.plan import NO_PLAN, confirmatory_section, plan_section
from avrgym.analysis.primary import primary_section
from avrgym.analysis.reading.rows import ParticipantRow
from avrgym.analysis.repeats import REPEATS_METHOD, repeats_section
from avrgym.analysis.sites import sites_section
from avrgym.analysis.statistics.tests import EXACT_SIGNED_RANK
from avrgym.analysis.streams import streams_section
from avrgym.analysis.study import Analysis
from avrgym.study.design.design import Design
from avrgym.study.storage.states import UNKNOWN
from avrgym.system.random_streams import TRAINING_PEOPLE_SEED
from avrgym.tasks.registry import TASKS

TITLES = {False: "People", True: "Simulated participants"}


def write_report(path: Path, analysis: Analysis, drawings: Sequence[Drawing], study_link: str) -> None:
    """Write the page; ``study_link`` leads from it to the study's folder. The same analysis gives the same bytes."""
    groups = sorted({row.simulated for row in analysis.observed.participants})
    header = [
        tag("p", "Analysis of the study as it stands."),
        _notices(analysis),
        _navigation(analysis, groups),
    ]
    sections = [_group(analysis, simulated, drawings, study_link) for simulated in groups]
    nobody = [tag("p", "Nobody has taken part yet: there is nothing to analyse.")] if not groups else []
    write_page(
        path,
        analysis.design.title,
        header,
        [
            differences_section(analysis.differences, analysis.items),
            plan_section(analysis.plan),
            *nobody,
            *sections,
            _facts(analysis),
            log_section(analysis.log, analysis.rebuilt_at),
            _problems(analysis),
            _methods(analysis),
        ],
    )


def _notices(analysis: Analysis) -> Markup:
    everyone = analysis.observed.participants
    notices: list[Markup] = differences_notice(analysis.differences)
    simulated = sum(row.simulated for row in everyone)
    if simulated:
        which = "All" if simulated == len(everyone) else f"{simulated} of the {len(everyone)}"
        words = (
            f"{which} participants here are simulated: poses and answers were made up by a program and say nothing "
            "about people. They are analysed apart and never taken together with people."
        )
        notices.append(warning_box("SIMULATED PARTICIPANTS.", words))
    notices += [warning_box("Rebuilt database.", words) for words in analysis.losses]
    if analysis.plan is not None and not analysis.plan.confirms:
        notices.append(
            warning_box("Exploratory.", "No plan is known to be from before the first participant.")
        )
    if any(use.design.blind_experimenter for use in analysis.uses) or analysis.design.blind_experimenter:
        notices.append(warning_box("Unblinded.", "This study is run blind; the page names the policies."))
    return join(notices)


def _navigation(analysis: Analysis, groups: Sequence[bool]) -> Markup:
    plan = [tag("a", DIFFERENCES_TITLE, href="#differences")] if analysis.differences else []
    plan += [tag("a", "The plan", href="#plan")] if analysis.plan else []
    links = [tag("a", TITLES[simulated], href=f"#{_id(simulated)}") for simulated in groups]
    return tag(
        "nav",
        *plan,
        *links,
        tag("a", "About the study", href="#facts"),
        tag("a", "The log", href="#log"),
        tag("a", "What is not as it should be", href="#problems"),
        tag("a", "Methods", href="#methods"),
    )


def _id(simulated: bool) -> str:
    return "simulated" if simulated else "people"


def _group(analysis: Analysis, simulated: bool, drawings: Sequence[Drawing], study_link: str) -> Markup:
    own = {
        each.name.rpartition("-")[0]: each
        for each in drawings
        if each.name.rpartition("-")[2] == _id(simulated)
    }
    mark = [badge("SIMULATED PARTICIPANTS")] if simulated else []
    tests = tables_of_tests(analysis.families, simulated)
    design, observed = analysis.design, analysis.observed
    confirmed = analysis.plan.confirmed if analysis.plan else None
    findings = analysis.repeat_findings if simulated is analysis.repeats_about else []
    return tag(
        "article",
        tag("h2", TITLES[simulated]),
        *mark,
        _counts(analysis, simulated),
        confirmatory_section(confirmed, analysis.tests, analysis.models, simulated),
        primary_section(analysis.tests, analysis.models, simulated, planned=confirmed is not None),
        outcomes_section(design, analysis.objective, simulated, own, tests),
        answers_section(design, analysis.subjective, analysis.session_answers, simulated, own, tests),
        scores_section(design, observed.scores, analysis.score_summaries, simulated, tests),
        models_section(analysis.models, simulated),
        biomechanics_section(analysis.biomechanics, analysis.ranges, simulated, own, tests),
        other_tests(tests),
        sites_section(
            observed.participants, observed.trials, analysis.site_outcomes, analysis.site_effects, simulated
        ),
        *([] if simulated else [adverse_events_section(analysis)]),
        streams_section(observed.streams, simulated),
        latency_section(analysis.latency, simulated),
        repeats_section(design, analysis.repeats, findings, simulated),
        trials_section(observed, simulated, study_link),
        id=_id(simulated),
    )


def _counts(analysis: Analysis, simulated: bool) -> Markup:
    people = [row for row in analysis.observed.participants if row.simulated is simulated]
    trials = [row for row in analysis.observed.trials if row.simulated is simulated]
    unknown = _in_state(people, UNKNOWN)
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
        "left out, persons held": sum(row.left_out is not None for row in trials),
        "Attempts": sum(row.attempts for row in trials),
        "broken off": sum(row.attempts_broken_off for row in trials),
    }
    sites = ["Site"] if any(row.site for row in people) else []
    rows = [
        (
            row.participant, *([row.site or ""] if sites else []), row.state, row.sex, row.language,
            "" if row.age_years is None else row.age_years,
            "" if row.torso_height_m is None else f"{row.torso_height_m:.3f}", row.sessions,
            row.trials_completed, row.trials_missing, row.attempts, row.attempts_broken_off,
        )
        for row in people
    ]  # fmt: skip
    heads = (
        "Participant", *sites, "State", "Body", "Language", "Age", "Torso / m", "Sessions", "Trials completed",
        "missing", "Attempts", "broken off",
    )  # fmt: skip
    also = " or whose consent is unknown" if unknown else ""
    caption = f"Participants, with those who withdrew{also}; these are in no analysis"
    left_out = [f"{row.participant}, trial {row.position}: {row.left_out}." for row in trials if row.left_out]
    listed = [tag("p", "Left out of the analyses:"), bullet_list(left_out)] if left_out else []
    shown = table(group_caption(caption, simulated), heads, rows, numbers=range(len(heads) - 7, len(heads)))
    return join([definition_list(metrics), *listed, shown])


def _in_state(people: Sequence[ParticipantRow], state: str) -> int:
    return sum(row.state == state for row in people)


def _facts(analysis: Analysis) -> Markup:
    """What a publication says of a study and its data do not."""
    design, uses = analysis.design, analysis.uses
    given = {
        name.replace("_", " ").capitalize(): text or "not given: [reporting] in study.toml has a field for it"
        for name, text in msgspec.structs.asdict(design.reporting).items()
    }
    rows = given | {
        "What participants read about the task": describe_by_design(uses, design, _told),
        "Real seat": describe_by_design(uses, design, _seat),
        "Real mattress": describe_by_design(uses, design, _mattress),
    }
    words = bullet_list([f"{name}: {text}" for name, text in rows.items()])
    note = "These values are from recordings, where there are any."
    planned = [] if analysis.plan else [tag("p", NO_PLAN)]
    return tag("section", tag("h2", "About the study"), words, tag("p", note), *planned, id="facts")


def _told(design: Design) -> str:
    return " ".join(f"{task}: {design.goals.get(task) or TASKS[task].goal}" for task in design.tasks)


def _seat(design: Design) -> str:
    seat = design.furniture
    return f"{seat.seat_height_m:g} m high, {seat.seat_depth_m:g} m deep, back at {seat.seat_back_deg:g}°"


def _mattress(design: Design) -> str:
    bed = design.furniture
    return f"{bed.mattress_height_m:g} m high, back at {bed.mattress_back_deg:g}°"


def _problems(analysis: Analysis) -> Markup:
    places: dict[tuple[str, str], list[str]] = {}
    for row in analysis.observed.problems:
        places.setdefault((row.what, row.consequence), []).append(row.where)
    lines = [_problem(what, consequence, where) for (what, consequence), where in places.items()]
    text = (
        count_text(len(analysis.observed.problems), "thing") + ":"
        if lines
        else "Nothing: every recording is here, whole and consistent."
    )
    body = [tag("p", text), bullet_list(lines)] if lines else [tag("p", text)]
    return tag("section", tag("h2", "What is not as it should be"), *body, id="problems")


def _problem(what: str, consequence: str, where: Sequence[str]) -> Markup:
    """A problem, once for all places that have it; many places are listed in details."""
    if len(where) == 1:
        return tag("span", f"{where[0]} {what}: {consequence}.")
    return tag("details", tag("summary", f"{len(where)} times: {what}: {consequence}."), bullet_list(where))


METHODS = (
    "Counted are completed trials but for practice, of participants who have not withdrawn. A trial is left out, and "
    "listed, whose person was held still, because tracking was lost or jumped, for a larger share of the time in which "
    "the robot helped than the design allows. Every table in tables/ has a column that marks rows about simulated "
    "participants.",
    "Reward: mean over participants with a 95 % interval by Student's t. Success: Wilson's 95 % interval; "
    "where participants have several trials, with the effective sample size. Next to them is the result of "
    "training for the same policy with its training population.",
    "Wilcoxon's signed-rank test: zeros are left out, ties share their mean rank; exact for at most "
    f"{EXACT_SIGNED_RANK} differences, else the normal approximation. Policies are paired within participant × task × "
    "robot. Over trials as in the paper, which takes the trials of one participant for independent; over participants "
    "each is one value, the mean of their trials.",
    "Effect: rank-biserial correlation, from −1 to 1, positive where the first group is larger; for energy distances "
    "the share from 0 to 1 that lies between the groups. Its 95 % interval is Wilson's of the share (1 + r) / 2 with "
    "the effective sample size of the ranks. Holm's correction holds within a family: one question, one unit.",
    "Primary results: p is corrected over all of them by flipping the signs of participants' differences together "
    "(Westfall and Young, 1993; Romano and Wolf, 2005). Models and unpaired tests that a plan makes primary are "
    "corrected by Holm; next to paired tests both corrected p are doubled. Rewards that are all equal have no "
    "interval.",
    f"The training's people: {PEOPLE_PER_TASK} drawn for each task and distribution, with seed {TRAINING_PEOPLE_SEED}.",
    "Head positions and torso heights: signed-rank as in the paper, each trial paired with an arbitrary person drawn; "
    "Mann-Whitney and the energy distance compare one value per participant with everyone drawn. Means of several "
    "trials spread less than single people, so that a small p need not mean another place.",
)


def _methods(analysis: Analysis) -> Markup:
    more = (
        "docs/reference/analysis.md in AVR Gym's repository describes the tables and how to recompute numbers. What a "
        "publication needs besides stands in reporting/index.html."
    )
    return tag(
        "section",
        tag("h2", "Methods"),
        bullet_list((*METHODS, *MODELS_METHOD, REPEATS_METHOD, LATENCY_METHOD)),
        headset_section(analysis.headsets),
        tag("p", more),
        id="methods",
    )
