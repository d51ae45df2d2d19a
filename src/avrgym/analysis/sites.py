"""Results of each site, for studies with several sites. The results are descriptive, without tests."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Annotated

from avrgym.analysis.answers.scores import compute_score_test_families
from avrgym.analysis.answers.session_answers import compute_session_test_families
from avrgym.analysis.answers.trial_answers import compute_answer_test_families
from avrgym.analysis.column_types import (
    EffectSize,
    EffectSizeHigh,
    EffectSizeLow,
    FamilyName,
    GroupAName,
    GroupBName,
    IsSimulated,
    MedianA,
    MedianB,
    QuantityName,
    ValueCount,
    ZeroDifferenceCount,
)
from avrgym.analysis.outcomes.condition_outcomes import ConditionOutcome, compute_condition_outcome
from avrgym.analysis.page.html_elements import (
    Markup,
    format_effect_size,
    format_group_caption,
    format_percentage,
    format_short_number,
    render_table,
    tag,
)
from avrgym.analysis.reading.table_rows import ALL_LABEL, AnswerRow, ParticipantRow, ScoreRow, TrialRow
from avrgym.analysis.statistics.comparisons import PARTICIPANT_UNIT, ComparisonRow
from avrgym.study.design.design import Design
from avrgym.system.columns import Column

SiteLabel = Annotated[str, Column("Site of the participants, or `no site`.")]


@dataclass(frozen=True, kw_only=True)
class SiteOutcomeRow(ConditionOutcome):
    """Results of the analysed trials in one condition at one site."""

    site: SiteLabel


@dataclass(frozen=True, kw_only=True)
class SiteEffectRow:
    """An effect size at one site, with one value for each participant. Columns: see ``ComparisonRow``."""

    simulated: IsSimulated
    site: SiteLabel
    family: FamilyName
    quantity: QuantityName
    group_a: GroupAName
    group_b: GroupBName
    n: ValueCount
    zeros: ZeroDifferenceCount
    median_a: MedianA
    median_b: MedianB
    effect: EffectSize
    effect_low: EffectSizeLow
    effect_high: EffectSizeHigh


NO_SITE_LABEL = "no site"
"""Site name of participants without a site."""


def make_site_outcome_rows(design: Design, trials: Sequence[TrialRow]) -> list[SiteOutcomeRow]:
    """Returns the results of each condition at each site; empty for a single site."""
    rows: list[SiteOutcomeRow] = []
    for simulated, site in _sites(trials):
        own = [
            row
            for row in trials
            if row.counted and row.simulated is simulated and find_site_label(row) == site
        ]
        for task, robot, policy in product((*design.tasks, ALL_LABEL), design.robots, design.policies):
            found = compute_condition_outcome(own, simulated, task, robot, policy)
            rows.append(SiteOutcomeRow(site=site, **asdict(found)))
    return rows


def make_site_effect_rows(
    design: Design, trials: Sequence[TrialRow], answers: Sequence[AnswerRow], scores: Sequence[ScoreRow]
) -> list[SiteEffectRow]:
    """Returns effect sizes of answers and scores at each site; empty for a single site."""
    rows: list[SiteEffectRow] = []
    for simulated, site in _sites(trials):
        given = [row for row in answers if row.simulated is simulated and find_site_label(row) == site]
        scored = [row for row in scores if row.simulated is simulated and find_site_label(row) == site]
        families = [
            *compute_answer_test_families(design, given),
            *compute_session_test_families(design, given),
            *compute_score_test_families(design, scored),
        ]
        rows += [
            _site_effect(site, row)
            for family in families
            for row in family.rows
            if row.unit == PARTICIPANT_UNIT
        ]
    return rows


def find_site_label(row: ParticipantRow | TrialRow | AnswerRow | ScoreRow) -> str:
    """Returns the site name in a row; ``NO_SITE_LABEL`` if the row has no site."""
    return row.site or NO_SITE_LABEL


def _sites(trials: Sequence[TrialRow]) -> Iterator[tuple[bool, str]]:
    """Yields (simulated, site name) for each site of a group. A group with a single site is omitted."""
    for simulated in (False, True):
        sites = sorted({find_site_label(row) for row in trials if row.counted and row.simulated is simulated})
        if len(sites) > 1:
            yield from ((simulated, site) for site in sites)


def _site_effect(site: str, row: ComparisonRow) -> SiteEffectRow:
    return SiteEffectRow(
        simulated=row.simulated,
        site=site,
        family=row.family,
        quantity=row.quantity,
        group_a=row.group_a,
        group_b=row.group_b,
        n=row.n,
        zeros=row.zeros,
        median_a=row.median_a,
        median_b=row.median_b,
        effect=row.effect,
        effect_low=row.effect_low,
        effect_high=row.effect_high,
    )


SITES_METHOD_TEXT = (
    "The tests above pool all sites. This section describes each site separately, with one value per participant, and "
    "tests nothing."
)


def render_sites_section(
    participants: Sequence[ParticipantRow],
    trials: Sequence[TrialRow],
    outcomes: Sequence[SiteOutcomeRow],
    effects: Sequence[SiteEffectRow],
    simulated: bool,
) -> Markup:
    """Returns the report section: participants, results and effect sizes of each site. Empty for a single site."""
    if not any(row.simulated is simulated for row in outcomes):
        return Markup()
    return tag(
        "section",
        tag("h3", "By site"),
        tag("p", SITES_METHOD_TEXT),
        _participants_table(participants, trials, simulated),
        _outcomes_table(outcomes, simulated),
        _effects_table(effects, simulated),
    )


def _participants_table(
    participants: Sequence[ParticipantRow], trials: Sequence[TrialRow], simulated: bool
) -> Markup:
    people = [row for row in participants if row.simulated is simulated]
    body = [
        (
            site,
            sum(find_site_label(row) == site for row in people),
            *(
                sum(find_site_label(row) == site and row.state == state for row in people)
                for state in ("completed", "withdrawn")
            ),
            sum(
                find_site_label(row) == site and row.counted and row.simulated is simulated for row in trials
            ),
        )
        for site in sorted({find_site_label(row) for row in people})
    ]
    heads = ("Site", "Participants", "completed the study", "withdrew", "Trials in the analyses")
    return render_table(
        format_group_caption("Participants of each site", simulated), heads, body, numbers=range(1, 5)
    )


def _outcomes_table(outcomes: Sequence[SiteOutcomeRow], simulated: bool) -> Markup:
    body = [
        (
            row.site,
            row.robot,
            row.policy,
            row.trials,
            format_percentage(row.success_rate, row.success_low, row.success_high),
        )
        for row in outcomes
        if row.simulated is simulated and row.task == ALL_LABEL
    ]
    heads = ("Site", "Robot", "Policy", "Trials", "Success")
    caption = format_group_caption(
        "Success over all tasks at each site, with 95 % confidence intervals", simulated
    )
    return render_table(caption, heads, body, numbers=(3, 4))


def _effects_table(effects: Sequence[SiteEffectRow], simulated: bool) -> Markup:
    rows = [row for row in effects if row.simulated is simulated]
    body = [
        (
            row.family, row.quantity, f"{row.group_a} / {row.group_b}", row.site,
            f"{row.n} + {row.zeros} zero" if row.zeros else row.n,
            f"{format_short_number(row.median_a)} / {format_short_number(row.median_b)}",
            format_effect_size(row.effect, row.effect_low, row.effect_high),
        )
        for row in sorted(rows, key=lambda row: (row.family, row.quantity, row.group_a, row.group_b, row.site))
    ]  # fmt: skip
    heads = ("Question", "Quantity", "Groups", "Site", "n", "Medians", "Effect size [95 % CI]")
    return render_table(
        format_group_caption("Effect sizes at each site", simulated), heads, body, numbers=(4, 5, 6)
    )
