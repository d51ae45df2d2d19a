"""Differences between the designs of participants, at the top of a study's page."""

from avrgym.analysis.page import Markup, listing, notice, table, tag
from avrgym.analysis.study import Analysis
from avrgym.study.storage.item_versions import base_name

TITLE = "Differences between participants"
NOTICE = (
    "Participants took part with different designs, or with another one than the study's folder contains. The section "
    "below lists each difference. Answers to different items are analysed separately; rewards, success and forces are "
    "taken together."
)


def differences_notice(analysis: Analysis) -> list[Markup]:
    """The notice; nothing where there is no difference."""
    wrong = any(each.wrong for each in analysis.differences)
    return [notice(f"{TITLE}.", NOTICE)] if wrong else []


def differences_section(analysis: Analysis) -> Markup:
    """Each difference with the participants and trials concerned, and the items that have versions."""
    if not analysis.differences:
        return Markup()
    lines = listing([f"{each.where}: {each.what}." for each in analysis.differences])
    return tag("section", tag("h2", TITLE), lines, *_versions(analysis), id="differences")


def _versions(analysis: Analysis) -> list[Markup]:
    changed = {base_name(row.item) for row in analysis.items if row.version > 1}
    shown = [row for row in analysis.items if base_name(row.item) in changed]
    if not shown:
        return []
    heads = ("Item", "Words", "From", "To", "Participants", "Answers")
    body = [
        (
            row.item + (" (simulated)" if row.simulated else ""), row.text, f"{row.least} ({row.low})",
            f"{row.most} ({row.high})", row.asked_of, row.answers,
        )
        for row in shown
    ]  # fmt: skip
    return [table("Items that were changed; each version is analysed separately", heads, body, numbers=(5,))]
