"""Checklist of reporting recommendations for studies of human-robot interaction: recommended fields and their values.

The selection follows Cordero et al. (What and How Are We Reporting in HRI?, arXiv:2201.09114, 2022), Bagchi et al.
(Towards Improved Replicability of Human Studies in HRI, HRI 2023 Companion, doi 10.1145/3568294.3580162) and the
participant flow of CONSORT (Schulz et al., BMJ 340, 2010, c332).
"""

from dataclasses import dataclass

from avrgym.analysis.designs import describe_by_design
from avrgym.analysis.flow import ParticipantFlow
from avrgym.analysis.page.elements import time_text
from avrgym.analysis.publication.methods import (
    analysed_session_designs,
    required_inclusion_answers,
    session_days_text,
)
from avrgym.analysis.study import StudyAnalysis
from avrgym.policies.names import OPERATOR_POLICY
from avrgym.study.design.description import describe_blinding, describe_conditions, describe_randomization


@dataclass(frozen=True)
class ChecklistField:
    """A recommended field of a publication.

    ``value``: text for the publication; empty if missing. ``source``: file or command that sets the value.
    """

    field: str
    value: str
    source: str = ""


def checklist_fields(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    """Returns all checklist fields for one group, in the order of a publication."""
    return [*_about_people(analysis, flow), *_about_the_study(analysis), *_about_the_analysis(analysis, flow)]


def _reporting(field: str, text: str, name: str) -> ChecklistField:
    return ChecklistField(field, text, f"{name} in [reporting] of study.toml")


def _about_people(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    about = analysis.design.reporting
    people = analysis.study_data.analysed_participants(simulated=flow.simulated)
    ages = sum(row.age_years is not None for row in people)
    withdrew = flow.withdrew_before_allocation + flow.withdrew
    left = f"{flow.excluded} excluded, {withdrew} withdrew, {flow.deleted} deleted"
    if lost := flow.withdrawal_unknown + flow.consent_unknown:
        left += f", of {lost} unknown"
    inclusion = describe_by_design(
        analysed_session_designs(analysis, flow), analysis.design, required_inclusion_answers
    )
    consent = ", ".join(
        f"version {version}: {number}" for version, number in flow.participants_by_consent_version.items()
    )
    if flow.reconsented or flow.declined:
        consent += f"; re-consent: {flow.reconsented} agreed, {flow.declined} declined"
    return [
        ChecklistField(
            "Number of participants",
            f"{flow.enrolled} enrolled, {flow.analysed} analysed" if flow.enrolled else "",
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
    flow = next(iter(analysis.flows), None)
    days = session_days_text(flow) if flow and flow.first_session_day else ""
    return [
        ChecklistField("Design and conditions", describe_conditions(design)),
        ChecklistField("Order and randomisation", describe_randomization(design)),
        ChecklistField("Blinding", describe_by_design(analysis.session_designs, design, describe_blinding)),
        ChecklistField("Robots", ", ".join(design.robots)),
        ChecklistField(
            "Control of the robots",
            f"the policies {', '.join(design.policies)}"
            + (
                "; for the policy operator, the experimenter"
                if OPERATOR_POLICY in design.policies
                else ", on their own"
            ),
        ),
        _reporting("Headset and controllers", about.headset, "headset"),
        _reporting("Place", about.location, "location"),
        ChecklistField("Dates", days, "the first session"),
        ChecklistField("Measures", f"reward, success, {measures}" if measures else "reward, success"),
    ]


def _about_the_analysis(analysis: StudyAnalysis, flow: ParticipantFlow) -> list[ChecklistField]:
    plan = analysis.frozen_plan.plan if analysis.frozen_plan else None
    rationale = plan.sample_size_rationale if plan else ""
    deviations = len(analysis.frozen_plan.deviations) if analysis.frozen_plan else 0
    own = [row for row in analysis.study_data.participants if row.simulated is flow.simulated]
    missing = sum(row.trials_missing for row in own)
    frozen = (
        f"frozen at {time_text(analysis.frozen_plan.frozen_at)} (UTC)"
        if analysis.frozen_plan and analysis.frozen_plan.is_confirmatory
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
