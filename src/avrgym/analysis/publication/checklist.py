"""Checklist of reporting recommendations for studies of human-robot interaction: recommended fields and their values.

The selection follows Cordero et al. (What and How Are We Reporting in HRI?, arXiv:2201.09114, 2022), Bagchi et al.
(Towards Improved Replicability of Human Studies in HRI, HRI 2023 Companion, doi 10.1145/3568294.3580162) and the
participant flow of CONSORT (Schulz et al., BMJ 340, 2010, c332).
"""

from dataclasses import dataclass

from avrgym.analysis.designs import describe_session_designs
from avrgym.analysis.page.html_elements import format_timestamp
from avrgym.analysis.participant_flow import ParticipantFlow
from avrgym.analysis.publication.methods import (
    find_analysed_session_designs,
    format_required_inclusion_answers,
    format_session_days,
)
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.policies.policy_names import OPERATOR_POLICY_NAME
from avrgym.study.design.design_description import (
    describe_blinding,
    describe_conditions,
    describe_randomization,
)


@dataclass(frozen=True)
class ChecklistField:
    """A recommended field of a publication.

    ``value``: text for the publication; empty if missing. ``source``: file or command that sets the value.
    """

    field: str
    value: str
    source: str = ""


def make_checklist_fields(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    """Returns all checklist fields for one group, in the order of a publication."""
    return [*_about_people(analysis, flow), *_about_the_study(analysis), *_about_the_analysis(analysis, flow)]


def _reporting(field: str, text: str, name: str) -> ChecklistField:
    return ChecklistField(field, text, f"{name} in [reporting] of study.toml")


def _about_people(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    about = analysis.design.reporting
    people = analysis.study_data.find_analysed_participants(simulated=flow.is_simulated)
    ages = sum(row.age_years is not None for row in people)
    withdrew = flow.early_withdrawal_count + flow.late_withdrawal_count
    left = f"{flow.excluded_participant_count} excluded, {withdrew} withdrew, {flow.deleted_participant_count} deleted"
    if lost := flow.unknown_withdrawal_count + flow.unknown_consent_count:
        left += f", of {lost} unknown"
    inclusion = describe_session_designs(
        find_analysed_session_designs(analysis, flow), analysis.design, format_required_inclusion_answers
    )
    consent = ", ".join(
        f"version {version}: {number}" for version, number in flow.participants_by_consent_version.items()
    )
    if flow.reconsented_participant_count or flow.declined_consent_count:
        consent += f"; re-consent: {flow.reconsented_participant_count} agreed, {flow.declined_consent_count} declined"
    return [
        ChecklistField(
            "Number of participants",
            f"{flow.enrolled_participant_count} enrolled, {flow.analysed_participant_count} analysed"
            if flow.enrolled_participant_count
            else "",
        ),
        ChecklistField(
            "Age",
            f"known for {ages} of {len(people)} in the analysis" if ages else "",
            "--age of `avrgym study enrol`",
        ),
        _reporting("Gender, as participants described it", about.gender, "gender"),
        _reporting("Experience with robots and VR", about.experience, "experience"),
        _reporting("Recruitment", about.recruitment, "recruitment"),
        _reporting("Compensation", about.compensation, "compensation"),
        _reporting("Ethics approval", about.ethics_approval, "ethics_approval"),
        ChecklistField("Informed consent", consent, "`avrgym study consent`"),
        ChecklistField("Inclusion criteria", inclusion, "[[inclusion]] in study.toml"),
        ChecklistField("Exclusions and dropouts", left),
    ]


def _about_the_study(analysis: StudyAnalysis) -> list[ChecklistField]:
    design, about = analysis.design, analysis.design.reporting
    measures = ", ".join(each.name for each in design.questionnaires)
    flow = next(iter(analysis.participant_flows), None)
    days = format_session_days(flow) if flow and flow.first_session_day else ""
    return [
        ChecklistField("Design and conditions", describe_conditions(design)),
        ChecklistField("Order and randomisation", describe_randomization(design)),
        ChecklistField(
            "Blinding", describe_session_designs(analysis.session_designs, design, describe_blinding)
        ),
        ChecklistField("Robots", ", ".join(design.robots)),
        ChecklistField(
            "Control of the robots",
            f"the policies {', '.join(design.policies)}"
            + (
                "; for the policy operator, the experimenter"
                if OPERATOR_POLICY_NAME in design.policies
                else ", on their own"
            ),
        ),
        _reporting("Headset and controllers", about.headset, "headset"),
        _reporting("Place", about.location, "location"),
        ChecklistField("Dates", days, "the first session"),
        ChecklistField("Measures", f"reward, success, {measures}" if measures else "reward, success"),
    ]


def _about_the_analysis(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    plan = analysis.plan_with_deviations.plan if analysis.plan_with_deviations else None
    rationale = plan.sample_size_rationale if plan else ""
    deviations = len(analysis.plan_with_deviations.deviations) if analysis.plan_with_deviations else 0
    own = [row for row in analysis.study_data.participants if row.simulated is flow.is_simulated]
    missing = sum(row.trials_missing for row in own)
    frozen = (
        f"frozen at {format_timestamp(analysis.plan_with_deviations.frozen_at)} (UTC)"
        if analysis.plan_with_deviations and analysis.plan_with_deviations.is_confirmatory
        else ""
    )
    return [
        ChecklistField(
            "Sample size and rationale", rationale, "sample_size_rationale in plan.toml, before it is frozen"
        ),
        ChecklistField("Preregistration", frozen, "`avrgym study freeze`, before the first participant"),
        ChecklistField(
            "Deviations from the plan", f"{deviations} listed" if plan else "", "`avrgym study freeze`"
        ),
        ChecklistField(
            "Statistical tests, effect sizes and corrections",
            "methods.md, tables/tests.csv, tables/models.csv",
        ),
        ChecklistField(
            "Missing data",
            f"{missing} planned trials not completed",
        ),
        _reporting("Data availability", analysis.design.reporting.data_availability, "data_availability"),
    ]
