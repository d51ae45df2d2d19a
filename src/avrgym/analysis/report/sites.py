"""The results of one group of participants by site on the page, where they took part at more than one."""

from avrgym.analysis.page import Markup, brief, table, tag
from avrgym.analysis.report.results import captioned, percent, with_interval
from avrgym.analysis.statistics.objective import ALL
from avrgym.analysis.statistics.sites import site_of
from avrgym.analysis.study import Analysis

METHOD = (
    "The tests above take all sites together. Here each site stands by itself, each participant with one value: this "
    "describes how far sites agree and tests nothing."
)


def by_site(analysis: Analysis, simulated: bool) -> Markup:
    """Who took part at each site, what policies gave there, and the effects in answers; nothing for one site."""
    if not any(row.simulated is simulated for row in analysis.site_outcomes):
        return Markup()
    return tag(
        "section",
        tag("h3", "By site"),
        tag("p", METHOD),
        _participants(analysis, simulated),
        _outcomes(analysis, simulated),
        _effects(analysis, simulated),
    )


def _participants(analysis: Analysis, simulated: bool) -> Markup:
    people = [row for row in analysis.observed.participants if row.simulated is simulated]
    trials = [row for row in analysis.observed.trials if row.simulated is simulated]
    body = [
        (
            site,
            sum(site_of(row) == site for row in people),
            *(
                sum(site_of(row) == site and row.state == state for row in people)
                for state in ("completed", "withdrawn")
            ),
            sum(site_of(row) == site and row.counted for row in trials),
        )
        for site in sorted({site_of(row) for row in people})
    ]
    heads = ("Site", "Participants", "completed the study", "withdrew", "Trials in the analyses")
    return table(captioned("Participants of each site", simulated), heads, body, numbers=range(1, 5))


def _outcomes(analysis: Analysis, simulated: bool) -> Markup:
    body = [
        (
            row.site,
            row.robot,
            row.policy,
            row.trials,
            percent(row.success_rate, row.success_low, row.success_high),
        )
        for row in analysis.site_outcomes
        if row.simulated is simulated and row.task == ALL
    ]
    heads = ("Site", "Robot", "Policy", "Trials", "Success")
    caption = captioned("Success over all tasks at each site, with 95 % intervals", simulated)
    return table(caption, heads, body, numbers=(3, 4))


def _effects(analysis: Analysis, simulated: bool) -> Markup:
    rows = [row for row in analysis.site_effects if row.simulated is simulated]
    body = [
        (
            row.family, row.quantity, f"{row.group_a} / {row.group_b}", row.site,
            f"{row.n} + {row.zeros} zero" if row.zeros else row.n,
            f"{brief(row.median_a)} / {brief(row.median_b)}",
            with_interval(row.effect, row.effect_low, row.effect_high),
        )
        for row in sorted(rows, key=lambda row: (row.family, row.quantity, row.group_a, row.group_b, row.site))
    ]  # fmt: skip
    heads = ("Question", "What", "Groups", "Site", "n", "Medians", "Effect [95 %]")
    return table(captioned("Effects at each site", simulated), heads, body, numbers=(4, 5, 6))
