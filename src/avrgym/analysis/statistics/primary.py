"""The primary result of each question of a study, corrected over all primary results.

Without a plan the primary results are the tests by participant of whether policies differ in each answer, score and
objective measure, of the first answer against the middle of its scale, and of changes over sessions. With a plan they
are the tests of its hypotheses. All other results are descriptive and have no stars.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from avrgym.analysis.model_rows import ModelRow
from avrgym.analysis.rows import TestedRow
from avrgym.analysis.statistics.families import PARTICIPANT, TRIAL, Family
from avrgym.analysis.statistics.joint import jointly_corrected
from avrgym.analysis.statistics.models.effects import POLICIES
from avrgym.analysis.statistics.tests import holm, mark
from avrgym.study.plan.plan import Plan

PRIMARY, SENSITIVITY, SECONDARY, SUPPLEMENT = "primary", "sensitivity analysis", "secondary", "supplement"
Place = tuple[int, int]
"""A family and a row in it."""


@dataclass(frozen=True)
class WithRoles:
    """The tests and effects of a study, each with its role, primary ones corrected and with stars."""

    families: list[Family]
    models: list[ModelRow]


def judged(families: Sequence[Family], models: Sequence[ModelRow], plan: Plan | None) -> WithRoles:
    """Give every test and effect its role; people and simulated participants are corrected apart.

    Args:
        families: the tests.
        models: the effects in models.
        plan: the plan that makes its tests confirmatory; ``None`` without one.
    """
    roles = {
        (at, place): _role(family, row, plan)
        for at, family in enumerate(families)
        for place, row in enumerate(family.rows)
    }
    of_models = [_role_of_effect(row, plan) for row in models]
    corrected: dict[Place, float | None] = {}
    of_effects: dict[int, float | None] = {}
    for simulated in (False, True):
        tests = [
            at for at, role in roles.items() if role == PRIMARY and families[at[0]].simulated is simulated
        ]
        effects = [
            at for at, row in enumerate(models) if of_models[at] == PRIMARY and row.simulated is simulated
        ]
        together = _corrected([_test(families, at) for at in tests], [models[at].p for at in effects])
        corrected |= dict(zip(tests, together, strict=False))
        of_effects |= dict(zip(effects, together[len(tests) :], strict=True))
    return WithRoles(
        [_with_roles(at, family, roles, corrected) for at, family in enumerate(families)],
        [
            replace(row, role=of_models[at], p_primary=of_effects.get(at), mark=mark(of_effects.get(at)))
            for at, row in enumerate(models)
        ],
    )


def primary_of(rows: Sequence[TestedRow]) -> list[TestedRow]:
    """The primary ones of some tests."""
    return [row for row in rows if row.role == PRIMARY]


def _role(family: Family, row: TestedRow, plan: Plan | None) -> str:
    """A hypothesis that names a test by trial is judged by the same test by participant."""
    if row.unit == TRIAL:
        return SUPPLEMENT
    if plan is None:
        return PRIMARY if family.question.primary else SECONDARY
    named = (family.question.by(unit) for unit in (PARTICIPANT, TRIAL))
    return PRIMARY if any(plan.hypotheses_of(name, row.quantity) for name in named) else SECONDARY


def _role_of_effect(row: ModelRow, plan: Plan | None) -> str:
    if plan is not None and plan.hypotheses_of(row.family, row.quantity):
        return PRIMARY
    return SENSITIVITY if row.effect == POLICIES else SECONDARY


Tested = tuple[float | None, Mapping[str, float]]
"""p of a test, and the differences of its participants, if they are paired."""


def _test(families: Sequence[Family], at: Place) -> Tested:
    family = families[at[0]]
    return family.rows[at[1]].p, family.differences[at[1]]


def _corrected(tests: Sequence[Tested], effects: Sequence[float | None]) -> list[float | None]:
    """p of tests, then of effects, corrected for all of them.

    Paired tests are corrected jointly, all others by Holm; where there are both, each p is doubled.
    """
    paired = [at for at, (p, differences) in enumerate(tests) if p is not None and differences]
    others = [(p if at not in paired else None) for at, (p, _) in enumerate(tests)] + list(effects)
    parts = bool(paired) + any(p is not None for p in others)
    found = [None if p is None else min(1.0, parts * p) for p in holm(others)]
    joint = jointly_corrected([tests[at][1] for at in paired])
    for at, p in zip(paired, joint, strict=True):
        found[at] = None if p is None else min(1.0, parts * max(p, tests[at][0] or 0.0))
    return found


def _with_roles(
    at: int, family: Family, roles: Mapping[Place, str], corrected: Mapping[Place, float | None]
) -> Family:
    def given() -> Iterator[TestedRow]:
        for place, row in enumerate(family.rows):
            p = corrected.get((at, place))
            yield replace(row, role=roles[at, place], p_primary=p, mark=mark(p))

    return replace(family, rows=tuple(given()))
