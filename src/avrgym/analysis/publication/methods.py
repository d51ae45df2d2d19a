"""Generate the text of the methods section of a publication."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from statistics import fmean, stdev

from avrgym.analysis.adverse_events import describe_adverse_events
from avrgym.analysis.biomechanics.training_populations import find_task_posture
from avrgym.analysis.commands import describe_condition
from avrgym.analysis.designs import describe_session_designs
from avrgym.analysis.headsets import describe_headset_checks
from avrgym.analysis.latency import find_total_latency_row
from avrgym.analysis.models.section import MODELS_METHOD_TEXT
from avrgym.analysis.page.html_elements import format_count
from avrgym.analysis.participant_flow import ParticipantFlow, make_flow_steps
from avrgym.analysis.reading.table_rows import ParticipantRow
from avrgym.analysis.sites import find_site_label
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.commands.respondents import PROXY_RESPONDENT
from avrgym.questionnaires.questionnaire import Questionnaire
from avrgym.study.design.design import Design
from avrgym.study.design.design_description import (
    describe_blinding,
    describe_conditions,
    describe_procedure,
    describe_randomization,
)
from avrgym.study.storage.item_versions import parse_design_name
from avrgym.study.storage.session_designs import SessionDesign
from avrgym.tasks.registry import TASKS
from avrgym.vr.session.attempt import read_package_versions

SIMULATED_DATA_TEXT = (
    "SIMULATED PARTICIPANTS: a program generated all data. They contain no information about people."
)
LOST_ANSWERS_TEXT = "Answers from before the rebuild of the database are lost."
MOMENT_DESCRIPTIONS = {
    "before_session": "before each session",
    "after_trial": "after each trial",
    "after_break": "after each break",
    "after_session": "after each session",
    "caregiver": "to caregivers",
}
MethodsSections = Mapping[str, list[str]]
"""The paragraphs of the methods section, by heading."""


def make_missing_text_placeholder(what: str) -> str:
    """Returns a placeholder for a text that the author must add. ``what``: the topic of the text."""
    return f"[MISSING: {what}]"


def make_methods_sections(analysis: StudyAnalysis, flow: ParticipantFlow) -> MethodsSections:
    """Returns the methods section about the group in ``flow``: people or simulated participants."""
    session_designs = find_analysed_session_designs(analysis, flow)
    sections = {
        "Participants": list(_participants(analysis, flow)),
        "Design": [
            describe_session_designs(session_designs, analysis.design, describe_conditions),
            describe_randomization(analysis.design),
            *_orders(flow),
            describe_session_designs(session_designs, analysis.design, describe_blinding),
        ],
        "Apparatus": list(_apparatus(analysis, flow)),
        "Procedure": [
            describe_session_designs(session_designs, analysis.design, describe_procedure),
            *_inclusion(analysis, flow),
        ],
        "Measures": list(_measures(analysis)),
        "Analysis": list(_analysis(analysis)),
        "Deviations from the plan": _deviations(analysis),
    }
    return {"": [SIMULATED_DATA_TEXT]} | sections if flow.is_simulated else sections


def find_analysed_session_designs(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[SessionDesign]:
    """Returns the session designs of the analysed participants in one group: people or simulated participants."""
    analysed = {
        row.participant for row in analysis.study_data.find_analysed_participants(simulated=flow.is_simulated)
    }
    return [use for use in analysis.session_designs if use.participant.pseudonym in analysed]


def format_methods_markdown(title: str, sections: MethodsSections) -> str:
    """Returns the methods section as Markdown text, with the heading ``title``."""
    lines = [f"# {title}: methods"]
    for heading, paragraphs in sections.items():
        lines += ([f"## {heading}"] if heading else []) + paragraphs
    return "\n\n".join(lines) + "\n"


def _participants(analysis: StudyAnalysis, flow: ParticipantFlow) -> Iterator[str]:
    about = analysis.design.reporting
    people = analysis.study_data.find_analysed_participants(simulated=flow.is_simulated)
    yield " ".join(_flow_sentences(flow))
    if people:
        words = f"{_ages(people)} {_bodies(people)} {_languages(people)}"
        yield f"Of the {format_count(len(people), _who(flow))} in the analysis: {words}"
    if any(row.site for row in people):
        yield _sites(people)
    yield from analysis.data_losses
    if flow.is_simulated:
        return
    yield f"Gender: {about.gender or make_missing_text_placeholder('gender, as participants described it')}"
    experience = about.experience or make_missing_text_placeholder("experience with robots and with VR")
    yield f"Experience with robots and VR: {experience}"
    yield f"Recruitment: {about.recruitment or make_missing_text_placeholder('recruitment of participants')}"
    yield f"Compensation: {about.compensation or make_missing_text_placeholder('compensation of participants')}"
    approval = about.ethics_approval or make_missing_text_placeholder("board and number of the approval")
    yield f"Ethics approval: {approval}"
    lost = flow.unknown_withdrawal_count + flow.unknown_consent_count
    unknown = (
        f"; unknown for {format_count(lost, 'participant')}, because the database was lost" if lost else ""
    )
    agreed = ", ".join(
        f"version {version} by {number}" for version, number in flow.participants_by_consent_version.items()
    )
    yield f"Participants first gave informed consent (text: {agreed or 'no participant so far'}){unknown}."
    if flow.reconsented_participant_count or flow.declined_consent_count:
        yield (
            "Re-consent to another version of the text, before the next session: "
            f"{flow.reconsented_participant_count} agreed, {flow.declined_consent_count} declined and withdrew."
        )
    yield describe_adverse_events(analysis)


def _who(flow: ParticipantFlow) -> str:
    return "simulated participant" if flow.is_simulated else "participant"


def _flow_sentences(flow: ParticipantFlow) -> Iterator[str]:
    """Yields a sentence about each step of the flow chart, with the numbers of dropouts after this step."""
    came = (
        f"{format_count(flow.enrolled_participant_count, _who(flow))} enrolled",
        f"{flow.allocated_participant_count} received an order of trials",
        f"{flow.completed_participant_count} completed the study",
    )
    *_, (analysed, _) = make_flow_steps(flow)
    for words, (_, left) in zip(came, make_flow_steps(flow), strict=False):
        yield f"{words} (left: {', '.join(left)})." if left else f"{words}."
    yield f"{analysed}."


def _ages(people: Sequence[ParticipantRow]) -> str:
    ages = [row.age_years for row in people if row.age_years is not None]
    if not ages:
        return f"Age: {make_missing_text_placeholder('ages')}."
    spread = f", standard deviation {stdev(ages):.1f}" if len(ages) > 1 else ""
    unknown = f", not given by {len(people) - len(ages)}" if len(ages) < len(people) else ""
    return f"Age: {min(ages)} to {max(ages)} years, mean {fmean(ages):.1f}{spread}{unknown}."


def _bodies(people: Sequence[ParticipantRow]) -> str:
    men = sum(row.sex == "man" for row in people)
    return f"{len(people) - men} were represented by a woman's body model, {men} by a man's."


def _languages(people: Sequence[ParticipantRow]) -> str:
    read = Counter(row.language for row in people)
    return f"Language of texts: {_shares(read)}."


def _sites(people: Sequence[ParticipantRow]) -> str:
    taken = Counter(find_site_label(row) for row in people)
    return f"Sites: {_shares(taken)}. Orders are balanced within each site. Tests pool all sites."


def _shares(times: Mapping[str, int]) -> str:
    return ", ".join(f"{name} ({number})" for name, number in sorted(times.items()))


def _orders(flow: ParticipantFlow) -> Iterator[str]:
    given = ", ".join(f"{number} ({times})" for number, times in flow.participants_by_order.items())
    yield (
        f"Orders of trials, with the number of participants: {given}."
        if given
        else "No participant has an order yet."
    )


def _apparatus(analysis: StudyAnalysis, flow: ParticipantFlow) -> Iterator[str]:
    design = analysis.design
    software = read_package_versions()
    checked = describe_headset_checks(
        [row for row in analysis.headset_checks if row.simulated is flow.is_simulated]
    )
    yield (
        f"AVR Gym {software.avrgym} simulated the robots ({', '.join(design.robots)}) and the person's body with "
        f"MuJoCo {software.mujoco} (as of this analysis; the report lists recordings of other versions). "
        f"Headset and controllers: "
        f"{design.reporting.headset or make_missing_text_placeholder('headset and controllers')}"
    )
    yield describe_session_designs(find_analysed_session_designs(analysis, flow), design, _equipment)
    for name, rules in design.conditions.items():
        yield f"Condition {name}: {describe_condition(rules)}"
    yield from _plugins(analysis, flow)
    yield _latency(analysis)
    if checked:
        yield checked


def _equipment(design: Design) -> str:
    """Returns sentences about seat or mattress, the force guard, and the withdrawal of the tool after success."""
    seat, postures = design.furniture, {find_task_posture(task) for task in design.tasks}
    places = {
        "seated": f"sat on a seat {seat.seat_height_m:g} m high",
        "in bed": f"lay on a mattress {seat.mattress_height_m:g} m high with its back at {seat.mattress_back_deg:g}°",
    }
    guarded = "A force guard limited" if design.force_guard else "No force guard limited"
    return (
        f"Participants {' and '.join(words for posture, words in places.items() if posture in postures)}. "
        f"{guarded} contact force and approach speed.{_withdrawal(design)}"
    )


def _withdrawal(design: Design) -> str:
    ending = [task.lower() for task in design.tasks if TASKS[task].withdraws_tool_after_success]
    if not (ending and design.withdraw_after_success):
        return ""
    return f" After success in {' and '.join(ending)} the robot withdrew its tool and waited."


def _plugins(analysis: StudyAnalysis, flow: ParticipantFlow) -> Iterator[str]:
    """Yields a sentence about the plug-ins in the recordings of the group; yields nothing without plug-ins."""
    used = Counter(
        f"{each.plugin_label}: {each.recorded_version}"
        for each in analysis.study_data.plugins
        if each.is_simulated is flow.is_simulated
    )
    if used:
        said = "; ".join(f"{what}, {format_count(number, 'trial')}" for what, number in sorted(used.items()))
        yield f"Plug-ins, with the hash of their files: {said}."


def _latency(analysis: StudyAnalysis) -> str:
    flow = select_publication_flow(analysis)
    total = find_total_latency_row(analysis.latency_summaries, simulated=flow.is_simulated) if flow else None
    if total is None:
        return f"Latency from pose to frame: {make_missing_text_placeholder('no recording contains it')}"
    return (
        "Latency from a tracked pose to the frame with its simulation: "
        f"{total.p50_ms:.0f} ms at the median, at most {total.p95_ms:.0f} ms for 95 % of {total.pictures} frames, "
        "without the headset's display. The participants' own arms appeared in the frame of their pose."
    )


def _inclusion(analysis: StudyAnalysis, flow: ParticipantFlow) -> Iterator[str]:
    asked = describe_session_designs(
        find_analysed_session_designs(analysis, flow), analysis.design, _inclusion_questions
    )
    if asked:
        yield f"{asked} {LOST_ANSWERS_TEXT}" if analysis.database_rebuilt_at else asked
    about = analysis.design.reporting
    days = (
        f"Sessions took place {format_session_days(flow)}."
        if flow.first_session_day
        else "No session took place yet."
    )
    yield f"{days} Place: {about.location or make_missing_text_placeholder('place of the sessions')}"


def format_required_inclusion_answers(design: Design) -> str:
    """Returns each inclusion question with its required answer, as text."""
    return " ".join(f"{each.text} {'Yes' if each.required else 'No'}." for each in design.inclusion)


def _inclusion_questions(design: Design) -> str:
    asked = format_required_inclusion_answers(design)
    return f"Required answers to inclusion questions: {asked}" if asked else ""


def format_session_days(flow: ParticipantFlow) -> str:
    """Returns the days of the first and last session, as text."""
    return (
        f"on {flow.first_session_day}"
        if flow.first_session_day == flow.last_session_day
        else f"from {flow.first_session_day} to {flow.last_session_day}"
    )


def _measures(analysis: StudyAnalysis) -> Iterator[str]:
    yield "Objective: the reward summed over a trial, and whether the robot succeeded."
    for each in analysis.design.questionnaires:
        yield _questionnaire(each)
    yield from _versions(analysis)
    by_proxy = sum(row.respondent == PROXY_RESPONDENT for row in analysis.study_data.answers)
    if by_proxy:
        yield f"Proxies gave {by_proxy} of {len(analysis.study_data.answers)} answers for participants."
    if analysis.design.practice_policy:
        yield "Practice trials have no questionnaire."


def _questionnaire(asked: Questionnaire) -> str:
    when = " and ".join(MOMENT_DESCRIPTIONS[moment] for moment in asked.moments)
    if asked.instrument is not None:
        source, answers = (
            f"{asked.instrument.title} ({asked.instrument.citation})",
            asked.instrument.response_scale,
        )
        steps = f" in steps of {answers.step}" if answers.step != 1 else ""
        ranged = f"from {answers.lowest_value} to {answers.highest_value}{steps}"
        scale = "with a choice of one of two" if answers.option_count == 2 else ranged
        return f"{asked.name}, asked {when}: {source}, {format_count(len(asked.items), 'item')} {scale}."
    scales = dict.fromkeys(asked.describe_response_scale(item) for item in asked.items)
    if len(scales) == 1:
        items = " ".join(f"{item.id}: “{item.text}”" for item in asked.items)
        return f"{asked.name}, asked {when}, answers {next(iter(scales))}: {items}"
    items = " ".join(
        f"{item.id}: “{item.text}” ({asked.describe_response_scale(item)})." for item in asked.items
    )
    return f"{asked.name}, asked {when}: {items}"


def _versions(analysis: StudyAnalysis) -> Iterator[str]:
    """Yields a sentence for each changed item: each version of its text and scale, with the number of participants that
    answered it."""
    changed = {parse_design_name(row.item) for row in analysis.item_versions if row.version > 1}
    asked = [
        f"{row.item} (“{row.text}”, from {row.minimum}, {row.low}, to {row.maximum}, {row.high}) was answered by "
        f"{row.participants}"
        for row in analysis.item_versions
        if parse_design_name(row.item) in changed
    ]
    if asked:
        yield f"Items were changed during the study: {'; '.join(asked)}. Versions are analysed separately."


def _analysis(analysis: StudyAnalysis) -> Iterator[str]:
    plan = analysis.plan_with_deviations
    if plan is None:
        yield "Nothing was preregistered: all tests are exploratory."
    elif plan.plan is None:
        yield f"The record of a frozen plan is missing or damaged: {make_missing_text_placeholder('the frozen plan')}"
    else:
        rationale = plan.plan.sample_size_rationale or make_missing_text_placeholder(
            "reason for this number of participants"
        )
        yield (
            f"{plan.date_evidence_text} The frozen record has the SHA-256 {plan.record_sha256}. "
            f"{plan.plan.participants} participants were planned: {rationale}"
        )
        yield " ".join(f"{each.id}: {each.text}" for each in plan.plan.hypotheses)
    yield (
        "Answers, scores of validated questionnaires, success, reward and force were compared by Wilcoxon's "
        "signed-rank test (two-sided, one value per participant), with rank-biserial correlations as effect sizes and "
        f"their 95 % intervals. Primary results: {_which_are_primary(analysis)}. Their p is corrected over all of "
        "them, by flipping the signs of participants' differences together (Westfall and Young, step-down)"
        f"{_other_corrections(analysis)}. All other "
        "results are sensitivity analyses, secondary or, by trial as in the paper of AVR Gym, a supplement. With fewer "
        f"than {MIN_PARTICIPANTS} participants there are no tests."
    )
    yield from MODELS_METHOD_TEXT


def _other_corrections(analysis: StudyAnalysis) -> str:
    """Returns a text about the correction of models and unpaired tests; empty without a confirmatory plan.

    Models and unpaired tests can be primary results only with a frozen plan.
    """
    if analysis.plan_with_deviations is None or analysis.plan_with_deviations.confirmatory_plan is None:
        return ""
    return (
        "; for models and unpaired tests by Holm's method (if there are also paired tests, each p is doubled)"
    )


def _which_are_primary(analysis: StudyAnalysis) -> str:
    if (
        analysis.plan_with_deviations is not None
        and analysis.plan_with_deviations.confirmatory_plan is not None
    ):
        return "the tests of the plan's hypotheses"
    return "differences between policies, the first answer against the midpoint of its scale, and changes over sessions"


def _deviations(analysis: StudyAnalysis) -> list[str]:
    if analysis.plan_with_deviations is None:
        return ["There was no plan to deviate from."]
    found = [f"{each.where}: {each.message}." for each in analysis.plan_with_deviations.deviations]
    return found or ["None."]


def select_publication_flow(analysis: StudyAnalysis) -> ParticipantFlow | None:
    """Returns the participant flow of people, or of simulated participants in a study without people.

    In a study without participants, returns ``None``.
    """
    return next(iter(analysis.participant_flows), None)
