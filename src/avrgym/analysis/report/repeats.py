"""Repeats of trials on a study's page, by policy, reason and person, with the findings about them."""

from collections import Counter
from collections.abc import Callable

from avrgym.analysis.page import Markup, listing, table, tag
from avrgym.analysis.repeat_rows import RepeatRow
from avrgym.analysis.report.results import captioned
from avrgym.analysis.study import Analysis

METHOD = (
    "Repeats: attempts at trials, practice left out, that a later attempt replaced. Experimenters order a repeat by "
    "repeat, skip, pause, stop, end, or measure again. Exact tests compare ordered repeats between policies, between "
    "robots with policies, and between first attempts with and without success, within participant and task. If "
    "repeats depend on nothing, they raise a finding in at most 1 % of studies. Attempts that were broken off before "
    "their end enter the comparison of policies and the limit, not that of outcomes."
)


def repeats(analysis: Analysis, simulated: bool) -> Markup:
    """Repeats of a group of participants."""
    rows = [row for row in analysis.repeats if row.simulated is simulated]
    found = analysis.repeat_findings if simulated is analysis.repeats_about else []
    listed = [listing([f"{each}." for each in found]), *_letters(analysis)] if found else []
    shown = [_table(rows, simulated)] if rows else []
    return tag("section", tag("h3", "Repeats"), tag("p", _words(rows)), *listed, *shown)


def _letters(analysis: Analysis) -> list[Markup]:
    """The letters that replace policies in the findings of a blind study."""
    if not analysis.design.blind_experimenter:
        return []
    codes = [f"{letter} is {policy}" for policy, letter in analysis.design.policy_codes().items()]
    return [tag("p", f"Letters stand for policies: {', '.join(sorted(codes))}.")]


def _words(rows: list[RepeatRow]) -> str:
    if not rows:
        return "No trial was repeated; practice is not counted."
    reasons = _summed(rows, lambda row: row.reason)
    people = _summed([row for row in rows if row.ordered_by], lambda row: row.ordered_by)
    total = sum(row.replaced for row in rows)
    attempts = "1 attempt was" if total == 1 else f"{total} attempts were"
    words = f"{attempts} replaced by repeats: {_listed(reasons)}."
    return f"{words} Ordered by: {_listed(people)}." if people else words


def _summed(rows: list[RepeatRow], key: Callable[[RepeatRow], str]) -> Counter[str]:
    found = Counter[str]()
    for row in rows:
        found[key(row)] += row.replaced
    return found


def _listed(counts: Counter[str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in counts.items())


def _table(rows: list[RepeatRow], simulated: bool) -> Markup:
    heads = (
        "Task", "Robot", "Policy", "Trials", "Reason", "Cause", "Ordered by", "Trials repeated", "Attempts replaced",
        "of them successes", "outcome unknown",
    )  # fmt: skip
    body = [
        (
            row.task, row.robot, row.policy, row.trials, row.reason, row.cause, row.ordered_by or "–", row.repeated,
            row.replaced, row.replaced_successes, row.success_unknown,
        )
        for row in rows
    ]  # fmt: skip
    caption = "Attempts that a repeat replaced, by condition, reason and person"
    return table(captioned(caption, simulated), heads, body, numbers=(3, 7, 8, 9, 10))
