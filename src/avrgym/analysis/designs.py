"""Differences between the study designs of participants: item versions, list of differences, and descriptions."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from avrgym.analysis.column_types import AT_LEAST_1_TEXT, IsSimulated, QuestionnaireName
from avrgym.analysis.page.html_elements import (
    Markup,
    render_bullet_list,
    render_table,
    render_warning_box,
    tag,
)
from avrgym.study.checking.finding import Finding
from avrgym.study.design.design import Design
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.storage.item_versions import AnsweredItems, parse_design_name
from avrgym.study.storage.session_designs import SessionDesign, describe_trials
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column

_ITEMS = COLUMNS_BY_TABLE["items"]


@dataclass(frozen=True, kw_only=True)
class ItemVersionRow:
    """One version of a questionnaire item. The row contains its number of answers from people or simulated
    participants."""

    simulated: IsSimulated
    questionnaire: QuestionnaireName
    item: Annotated[str, _ITEMS["item"]]
    version: Annotated[
        int,
        Column("Version of the item; it increases when an answered item changes.", allowed=AT_LEAST_1_TEXT),
    ]
    text: Annotated[str, _ITEMS["text"]]
    minimum: Annotated[int, _ITEMS["minimum"]]
    maximum: Annotated[int, _ITEMS["maximum"]]
    points: Annotated[int, _ITEMS["points"]]
    low: Annotated[str, _ITEMS["low"]]
    high: Annotated[str, _ITEMS["high"]]
    participants: Annotated[str, Column("The participants who answered it.")]
    answers: Annotated[int, Column("Number of answers to it.", allowed=AT_LEAST_1_TEXT)]


def make_item_version_rows(store: StudyStore, answered_items: AnsweredItems) -> list[ItemVersionRow]:
    """Returns a row for each answered version of each item, separately for people and simulated participants."""
    simulated = {each.pseudonym: each.simulated for each in store.read_participants()}
    scales = {
        item.id: own.find_response_scale(item)
        for own in answered_items.design.questionnaires
        for item in own.items
    }
    return [
        ItemVersionRow(
            simulated=group,
            questionnaire=version.questionnaire_name,
            item=version.item.id,
            version=version.version_number,
            text=version.item.text,
            minimum=scale.lowest_value,
            maximum=scale.highest_value,
            points=scale.option_count,
            low=version.item.low,
            high=version.item.high,
            participants=", ".join(sorted(own)),
            answers=sum(own.values()),
        )
        for version in answered_items.item_versions
        for scale in (scales[version.item.id],)
        for group in (False, True)
        for own in (
            {name: n for name, n in version.answer_count_by_participant.items() if simulated[name] is group},
        )
        if own
    ]


DESIGN_DIFFERENCES_TITLE = "Differences between participants"
DESIGN_DIFFERENCES_TEXT = (
    "Participants took part with designs that differ from each other, or from the design in the "
    "study's folder. The section "
    "below lists each difference. Answers to different items are analysed separately; rewards, success and forces are "
    "taken together."
)


def render_design_differences_notice(differences: Sequence[Finding]) -> list[Markup]:
    """Returns a warning that designs differ; an empty list if no difference is an error."""
    has_errors = any(each.is_error for each in differences)
    return [render_warning_box(f"{DESIGN_DIFFERENCES_TITLE}.", DESIGN_DIFFERENCES_TEXT)] if has_errors else []


def render_design_differences_section(
    differences: Sequence[Finding], items: Sequence[ItemVersionRow]
) -> Markup:
    """Returns the report section: each difference between designs, and all versions of changed items.

    The section is empty if there are no differences.
    """
    if not differences:
        return Markup()
    lines = render_bullet_list([f"{each.where}: {each.message}." for each in differences])
    return tag("section", tag("h2", DESIGN_DIFFERENCES_TITLE), lines, *_versions(items), id="differences")


def _versions(items: Sequence[ItemVersionRow]) -> list[Markup]:
    changed = {parse_design_name(row.item) for row in items if row.version > 1}
    shown = [row for row in items if parse_design_name(row.item) in changed]
    if not shown:
        return []
    heads = ("Item", "Words", "From", "To", "Participants", "Answers")
    body = [
        (
            row.item + (" (simulated)" if row.simulated else ""), row.text, f"{row.minimum} ({row.low})",
            f"{row.maximum} ({row.high})", row.participants, row.answers,
        )
        for row in shown
    ]  # fmt: skip
    return [
        render_table(
            "Items that were changed; each version is analysed separately", heads, body, numbers=(5,)
        )
    ]


def describe_session_designs(
    session_designs: Iterable[SessionDesign], design: Design, words: Callable[[Design], str]
) -> str:
    """Returns a description of all session designs. If descriptions differ, each is listed with its trials.

    ``words``: function that returns the description of a design. If there are no session designs, the description of
    ``design`` is returned.
    """
    groups: dict[str, list[SessionDesign]] = {}
    for use in session_designs:
        groups.setdefault(words(use.design), []).append(use)
    if len(groups) < 2:
        return next(iter(groups), None) or words(design)
    return " ".join(f"For {describe_trials(own)}: {_sentence(text)}" for text, own in groups.items())


def _sentence(text: str) -> str:
    return text if text.endswith((".", "!", "?")) else f"{text}."
