"""Results by site, where participants took part at more than one: how far the sites agree, without tests."""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import product

from avrgym.analysis.rows import AnswerRow, ParticipantRow, TestedRow, TrialRow
from avrgym.analysis.score_rows import ScoreRow
from avrgym.analysis.site_rows import SiteEffectRow, SiteOutcomeRow
from avrgym.analysis.statistics.families import PARTICIPANT
from avrgym.analysis.statistics.objective import ALL, outcome
from avrgym.analysis.statistics.scores import score_families
from avrgym.analysis.statistics.session_answers import session_families
from avrgym.analysis.statistics.subjective import answer_families
from avrgym.study.design.design import Design

NO_SITE = "no site"
"""Of participants of whom no site was said, beside others."""


def site_outcome_rows(design: Design, trials: Sequence[TrialRow]) -> list[SiteOutcomeRow]:
    """What each condition gave at each site; nothing for people or simulated participants of one site."""
    rows: list[SiteOutcomeRow] = []
    for simulated, site in _sites(trials):
        own = [row for row in trials if row.counted and row.simulated is simulated and site_of(row) == site]
        for task, robot, policy in product((*design.tasks, ALL), design.robots, design.policies):
            found = outcome(own, simulated, task, robot, policy)
            rows.append(SiteOutcomeRow(site=site, **asdict(found)))
    return rows


def site_effect_rows(
    design: Design, trials: Sequence[TrialRow], answers: Sequence[AnswerRow], scores: Sequence[ScoreRow]
) -> list[SiteEffectRow]:
    """The effects in answers and scores at each site; nothing for people or simulated participants of one site."""
    rows: list[SiteEffectRow] = []
    for simulated, site in _sites(trials):
        given = [row for row in answers if row.simulated is simulated and site_of(row) == site]
        scored = [row for row in scores if row.simulated is simulated and site_of(row) == site]
        families = [
            *answer_families(design, given),
            *session_families(design, given),
            *score_families(design, scored),
        ]
        rows += [_effect(site, row) for family in families for row in family.rows if row.unit == PARTICIPANT]
    return rows


def site_of(row: ParticipantRow | TrialRow | AnswerRow | ScoreRow) -> str:
    """A row's site."""
    return row.site or NO_SITE


def _sites(trials: Sequence[TrialRow]) -> Iterator[tuple[bool, str]]:
    """Each site of people and of simulated participants, where they are of more than one."""
    for simulated in (False, True):
        sites = sorted({site_of(row) for row in trials if row.counted and row.simulated is simulated})
        if len(sites) > 1:
            yield from ((simulated, site) for site in sites)


def _effect(site: str, row: TestedRow) -> SiteEffectRow:
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
