"""What a study's page says of its plan: what was planned, what came of it, and in what the study deviates."""

from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.page import Markup, join, listing, tag
from avrgym.analysis.report.models import table_of_effects
from avrgym.analysis.report.results import table_of_tests
from avrgym.analysis.rows import TestedRow
from avrgym.analysis.study import Analysis, FrozenPlan
from avrgym.study.plan.plan import Hypothesis, Plan

NOTHING = (
    "No plan was frozen before the first participant: nothing was preregistered, every test is exploratory."
)


def plan_section(analysis: Analysis) -> Markup:
    """The plan and the deviations from it; nothing where none was frozen."""
    if analysis.plan is None:
        return Markup()
    parts = (_frozen(analysis.plan), _deviations(analysis.plan))
    return tag("section", tag("h2", "The plan"), *parts, id="plan")


def _frozen(frozen: FrozenPlan) -> Markup:
    if frozen.plan is None:
        return tag("p", "The record of a frozen plan is missing or damaged: nothing is confirmatory.")
    plan = frozen.plan
    tests = "Tests of its hypotheses are confirmatory, all others are exploratory." if frozen.confirms else ""
    words = (
        f"{frozen.words} The SHA-256 of plan.toml is {frozen.sha256}, that of plan-frozen.json {frozen.record_sha256}. "
        f"{tests}"
    )
    said = {
        "Participants planned": str(plan.participants),
        "Why so many": plan.sample_size_rationale,
        "When taking people in ends": plan.stopping_rule,
        "Left out": f"trials whose person was held for more than {100 * plan.exclusion.max_held_share:g} % of the time",
        "Left out too": " ".join(plan.exclusion.further),
        "Settled beforehand": plan.other,
    }
    return join([tag("p", words), listing([f"{name}: {text}" for name, text in said.items() if text])])


def _deviations(frozen: FrozenPlan) -> Markup:
    found = [f"{each.where}: {each.what}." for each in frozen.deviations]
    if not found:
        return join([tag("h3", "Deviations"), tag("p", "None.")])
    return join([tag("h3", "Deviations"), listing(found)])


def confirmatory(analysis: Analysis, simulated: bool) -> Markup:
    """The tests of the plan's hypotheses for a group of participants; nothing where no plan was frozen."""
    plan = analysis.plan.confirmed if analysis.plan else None
    if plan is None:
        return Markup()
    shown = [_hypothesis(analysis, plan, each, simulated) for each in plan.hypotheses]
    note = (
        "These tests were planned. All other tests are exploratory. “p, corrected” is that of the primary results; "
        "“p, Holm” is corrected within one family only."
    )
    return tag("section", tag("h3", "Confirmatory results"), tag("p", note), *shown)


def _hypothesis(analysis: Analysis, plan: Plan, hypothesis: Hypothesis, simulated: bool) -> Markup:
    def judged(row: TestedRow | ModelRow) -> bool:
        return row.simulated is simulated and hypothesis in plan.hypotheses_of(row.family, row.quantity)

    tests, effects = list(filter(judged, analysis.tests)), list(filter(judged, analysis.models))
    caption = f"{hypothesis.id}: {', '.join(hypothesis.tests)}"
    parts = [table_of_tests(caption, tests, simulated)] if tests else []
    parts += [table_of_effects(caption, effects, simulated)] if effects else []
    return join(
        [
            tag("p", f"{hypothesis.id}: {hypothesis.text}"),
            *(parts or [tag("p", "There is nothing to test yet.")]),
        ]
    )
