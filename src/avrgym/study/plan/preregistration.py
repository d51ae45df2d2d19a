"""Write a study's plan as the fields of a preregistration form.

The forms are OSF's standard form (Bowman et al. 2016, doi 10.31222/osf.io/epgjd) and AsPredicted (aspredicted.org). The
headings are shortened.
"""

from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from avrgym.study.design.design import Design
from avrgym.study.design.design_description import (
    describe_blinding,
    describe_conditions,
    describe_procedure,
    describe_randomization,
)
from avrgym.study.plan.analysis_plan import AnalysisPlan, AvailableTests, read_analysis_plan
from avrgym.study.plan.exclusion_rules import ExclusionRule
from avrgym.study.plan.frozen_plan import (
    FROZEN_PLAN_FILE,
    check_plan_can_be_frozen,
    read_frozen_plan_evidence,
)
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import read_user_text, write_private_file

FormFields = Mapping[str, Mapping[str, str]]
"""Texts by section and heading."""
NOT_SPECIFIED_TEXT = "(not specified)"
NO_DATA_YET_TEXT = "None: a plan can be frozen only before the first participant."


def write_preregistration(store: StudyStore, available_tests: AvailableTests, form: str) -> Path:
    """Write a study's plan, frozen or not, as the fields of a form. Returns the file's path.

    Raises:
        DesignError: if the plan is invalid.
        StudyError: for an unknown form, or if the file exists with another text. Also for a damaged frozen plan, a
            frozen plan of unknown date, or no frozen plan after the first participant.
        OSError: if a file cannot be read or written.
    """
    if form not in PREREGISTRATION_FORMS:
        raise StudyError(f"unknown form {form!r}; allowed: {', '.join(PREREGISTRATION_FORMS)}")
    title, fields = PREREGISTRATION_FORMS[form]
    frozen = read_frozen_plan_evidence(store)
    if frozen is None:
        check_plan_can_be_frozen(store)
        plan, state = read_analysis_plan(store.folder, store.design, available_tests)[0], "Not frozen yet."
    elif frozen.frozen_plan is None or not frozen.is_confirmatory:
        raise StudyError(f"{FROZEN_PLAN_FILE} {'; '.join(frozen.error_messages)}")
    else:
        plan, state = (
            frozen.frozen_plan.parse_plan(),
            f"Frozen with AVR Gym at {frozen.existed_since_text} (UTC).",
        )
    text = format_markdown(
        f"{store.design.title}: {title}", state, fields(store.design, plan, available_tests)
    )
    return write_draft(store.folder / f"preregistration-{form}.md", text)


def write_draft(path: Path, text: str) -> Path:
    """Write a new file. Returns its path. Raises ``StudyError`` if the file exists with another text."""
    try:
        write_private_file(path, text)
    except FileExistsError:
        if read_user_text(path) != text:
            raise StudyError(f"{path} exists already with another text; remove it first") from None
    return path


def format_markdown(title: str, state: str, fields: FormFields) -> str:
    """Returns fields as a Markdown text. ``state``: the paragraph after the title."""
    lines = [f"# {title}", state]
    for section, answers in fields.items():
        lines += [f"## {section}"] if section else []
        for heading, text in answers.items():
            lines += [f"### {heading}", text or NOT_SPECIFIED_TEXT]
    return "\n\n".join(lines) + "\n"


def _osf(design: Design, plan: AnalysisPlan, available_tests: AvailableTests) -> FormFields:
    return {
        "Study information": {
            "Title": design.title,
            "Description": describe_procedure(design),
            "Hypotheses": _hypotheses(plan),
        },
        "Design plan": {
            "Study type": "Experiment",
            "Blinding": describe_blinding(design),
            "Study design": describe_conditions(design),
            "Randomization": describe_randomization(design),
        },
        "Sampling plan": {
            "Existing data": "Registration prior to creation of data",
            "Explanation of existing data": NO_DATA_YET_TEXT,
            "Data collection procedures": _procedures(design),
            "Sample size": f"{plan.participants} participants.",
            "Sample size rationale": plan.sample_size_rationale,
            "Stopping rule": plan.stopping_rule,
        },
        "Variables": {
            "Manipulated variables": _manipulated(design),
            "Measured variables": _measures(design, plan),
            "Indices": "By participant: the mean of a participant's trials of a condition. By trial: none.",
        },
        "Analysis plan": {
            "Statistical models": _tests(plan, available_tests),
            "Transformations": "None; signed-rank tests omit zero differences, and ties get their mean rank.",
            "Inference criteria": _inference(),
            "Data exclusion": _exclusion(design, plan),
            "Missing data": "If one trial of a pair is missing, the test excludes the other trial.",
            "Exploratory analyses": format_bullet_list(plan.exploratory),
        },
        "Other": {"Other": plan.other},
    }


def _aspredicted(design: Design, plan: AnalysisPlan, available_tests: AvailableTests) -> FormFields:
    questions = {
        "Data collected already": NO_DATA_YET_TEXT,
        "Question or hypothesis": _hypotheses(plan),
        "Dependent variables": _measures(design, plan),
        "Conditions": f"{describe_conditions(design)} {describe_randomization(design)}",
        "Analyses": f"{_tests(plan, available_tests)}\n\n{_inference()}",
        "Outliers and exclusions": _exclusion(design, plan),
        "Number of observations": _paragraphs(
            f"{plan.participants} participants.", plan.stopping_rule, plan.sample_size_rationale
        ),
        "Anything else": _paragraphs(
            plan.other, f"Exploratory tests:\n\n{format_bullet_list(plan.exploratory)}"
        ),
    }
    return {"": {f"{number}. {name}": text for number, (name, text) in enumerate(questions.items(), start=1)}}


PREREGISTRATION_FORMS: Mapping[
    str, tuple[str, Callable[[Design, AnalysisPlan, AvailableTests], FormFields]]
] = {
    "osf": ("fields of the OSF preregistration", _osf),
    "aspredicted": ("answers for AsPredicted", _aspredicted),
}
"""Title and function of each form, by name."""


# Facts about a study


def _hypotheses(plan: AnalysisPlan) -> str:
    return format_bullet_list(f"{each.id}: {each.text}" for each in plan.hypotheses)


def _procedures(design: Design) -> str:
    asked = [f"{each.text} {'Yes' if each.required else 'No'}." for each in design.inclusion]
    about = design.reporting
    return _paragraphs(
        f"Recruitment: {about.recruitment or NOT_SPECIFIED_TEXT}",
        f"Compensation: {about.compensation or NOT_SPECIFIED_TEXT}",
        f"Ethics approval: {about.ethics_approval or NOT_SPECIFIED_TEXT}",
        f"Participants consent and answer as follows:\n\n{format_bullet_list(asked)}" if asked else "",
    )


def _manipulated(design: Design) -> str:
    levels = {"Task": design.tasks, "Robot": design.robots, "Policy": design.policies}
    return format_bullet_list(f"{name}: {', '.join(each)}" for name, each in levels.items())


def _measures(design: Design, plan: AnalysisPlan) -> str:
    """Returns the primary measures as a Markdown list. Items have their text and scale."""
    names = dict.fromkeys(measure for each in plan.hypotheses for measure in each.measures)
    return format_bullet_list(_measure(design, name) for name in names)


def _measure(design: Design, name: str) -> str:
    questionnaire = design.find_item_questionnaire(name)
    if questionnaire is None:
        return name
    item = design.items_by_id[name]
    scale = questionnaire.describe_response_scale(item)
    return f"{name}: {item.text} {scale[0].upper()}{scale[1:]}."


def _tests(plan: AnalysisPlan, available_tests: AvailableTests) -> str:
    return format_bullet_list(
        f"{each.id}: {test} ({'; '.join(name for name in available_tests.get(test, ()) if name in each.measures)})"
        for each in plan.hypotheses
        for test in each.tests
    )


def _inference() -> str:
    return (
        "Two-sided, p below 0.05 after correction for all tests of the hypotheses: paired tests jointly, by flipping "
        "the signs of participants' differences, others by Holm. Wilcoxon's signed-rank test for answers, each "
        "participant one value, with exact p for up to 50 differences; docs/reference/analysis.md lists other tests."
    )


def _exclusion(design: Design, plan: AnalysisPlan) -> str:
    rules = [
        "Trials in which tracking was lost or jumped for more than "
        f"{100 * plan.exclusion.max_held_share:g} % of the time in which the robot helped.",
        "All trials of withdrawn participants; practice trials; trials that were not completed.",
        *(
            ["Participants with another answer to an inclusion question are excluded."]
            if design.inclusion
            else []
        ),
    ]
    by_name = [
        f"Participants who violate the rule {each.name!r}: {_rule(each)}" for each in plan.exclusion.rules
    ]
    return format_bullet_list([*rules, *by_name, *plan.exclusion.other_rules])


def _rule(rule: ExclusionRule) -> str:
    """Returns an exclusion rule as a sentence."""
    most = f"more than {100 * rule.max_share:g} %"
    if rule.kind == "attention":
        right = ", ".join(map(str, rule.allowed))
        return f"{most} of the answers to {rule.item} differ from {right}."
    if rule.kind == "straight_lining":
        return f"all answers are equal in {most} of the questionnaires."
    return f"the median time for an item is below {rule.min_seconds:g} s."


def format_bullet_list(items: Iterable[str]) -> str:
    """Returns items as a Markdown list."""
    return "\n".join(f"- {item}" for item in items)


def _paragraphs(*texts: str) -> str:
    return "\n\n".join(text for text in texts if text)
