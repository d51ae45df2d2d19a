"""Select the primary results of a study, and correct their p values for multiple testing.

Without a frozen plan, the primary results are these tests by participant:

* differences between policies in each answer, score and objective measure
* the first answer against the midpoint of its scale
* changes over sessions

With a frozen plan, the primary results are the tests of its hypotheses. All other results are descriptive and have no
significance stars.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

from avrgym.analysis.models.effects import POLICY_EFFECT
from avrgym.analysis.models.models import ModelRow
from avrgym.analysis.models.section import effect_text
from avrgym.analysis.page.comparisons import sample_size_text
from avrgym.analysis.page.elements import (
    Markup,
    badge,
    effect_size_text,
    group_caption,
    p_text,
    short_number_text,
    table,
    tag,
)
from avrgym.analysis.statistics.comparisons import (
    MIN_PARTICIPANTS,
    PARTICIPANT_UNIT,
    PRIMARY,
    SECONDARY,
    SENSITIVITY,
    SUPPLEMENT,
    TOO_FEW_PARTICIPANTS_TEXT,
    TRIAL_UNIT,
    ComparisonFamily,
    ComparisonRow,
)
from avrgym.analysis.statistics.sign_flips import sign_flip_p_values
from avrgym.analysis.statistics.tests import holm_correction, significance_stars
from avrgym.study.plan.plan import Plan

TestIndex = tuple[int, int]
"""Index of a test: (index of the family, index of the row in the family)."""


@dataclass(frozen=True)
class ResultsWithRoles:
    """Tests and model effects with their roles (such as primary).

    Primary results also have a corrected p value and significance stars.
    """

    families: list[ComparisonFamily]
    model_rows: list[ModelRow]


def assign_result_roles(
    families: Sequence[ComparisonFamily], models: Sequence[ModelRow], plan: Plan | None
) -> ResultsWithRoles:
    """Returns all tests and model effects with their roles. p values are corrected separately for simulated
    participants.

    Args:
        families: the families of tests.
        models: the model effects.
        plan: the confirmatory plan; ``None`` without a confirmatory plan.
    """
    roles = {
        (at, place): _role_of_test(family, row, plan)
        for at, family in enumerate(families)
        for place, row in enumerate(family.rows)
    }
    of_models = [_role_of_effect(row, plan) for row in models]
    corrected: dict[TestIndex, float | None] = {}
    of_effects: dict[int, float | None] = {}
    for simulated in (False, True):
        tests = [
            at for at, role in roles.items() if role == PRIMARY and families[at[0]].simulated is simulated
        ]
        effects = [
            at for at, row in enumerate(models) if of_models[at] == PRIMARY and row.simulated is simulated
        ]
        together = _corrected(
            [_p_and_differences(families, at) for at in tests], [models[at].p for at in effects]
        )
        corrected |= dict(zip(tests, together, strict=False))
        of_effects |= dict(zip(effects, together[len(tests) :], strict=True))
    return ResultsWithRoles(
        [_with_roles(at, family, roles, corrected) for at, family in enumerate(families)],
        [
            replace(
                row,
                role=of_models[at],
                p_primary=of_effects.get(at),
                stars=significance_stars(of_effects.get(at)),
            )
            for at, row in enumerate(models)
        ],
    )


def _role_of_test(family: ComparisonFamily, row: ComparisonRow, plan: Plan | None) -> str:
    """Returns the role of a test. If a hypothesis contains a test by trial, the test by participant is primary."""
    if row.unit == TRIAL_UNIT:
        return SUPPLEMENT
    if plan is None:
        return PRIMARY if family.question.is_primary else SECONDARY
    named = (family.question.family_name(unit) for unit in (PARTICIPANT_UNIT, TRIAL_UNIT))
    return PRIMARY if any(plan.hypotheses_of(name, row.quantity) for name in named) else SECONDARY


def _role_of_effect(row: ModelRow, plan: Plan | None) -> str:
    if plan is not None and plan.hypotheses_of(row.family, row.quantity):
        return PRIMARY
    return SENSITIVITY if row.effect == POLICY_EFFECT else SECONDARY


PValueAndDifferences = tuple[float | None, Mapping[str, float]]
"""(p value, difference of each participant) of a test. For unpaired tests, there are no differences."""


def _p_and_differences(families: Sequence[ComparisonFamily], at: TestIndex) -> PValueAndDifferences:
    family = families[at[0]]
    return family.rows[at[1]].p, family.participant_differences[at[1]]


def _corrected(tests: Sequence[PValueAndDifferences], effects: Sequence[float | None]) -> list[float | None]:
    """Returns the corrected p values of the tests, then of the model effects. ``effects``: uncorrected p values.

    Paired tests are corrected by sign-flip permutation, all other results by Holm's method. If there are results of
    both kinds, each corrected p value is doubled (Bonferroni).
    """
    paired = [at for at, (p, differences) in enumerate(tests) if p is not None and differences]
    others = [(p if at not in paired else None) for at, (p, _) in enumerate(tests)] + list(effects)
    parts = bool(paired) + any(p is not None for p in others)
    found = [None if p is None else min(1.0, parts * p) for p in holm_correction(others)]
    joint = sign_flip_p_values([tests[at][1] for at in paired])
    for at, p in zip(paired, joint, strict=True):
        found[at] = None if p is None else min(1.0, parts * max(p, tests[at][0] or 0.0))
    return found


def _with_roles(
    at: int,
    family: ComparisonFamily,
    roles: Mapping[TestIndex, str],
    corrected: Mapping[TestIndex, float | None],
) -> ComparisonFamily:
    def given() -> Iterator[ComparisonRow]:
        for place, row in enumerate(family.rows):
            p = corrected.get((at, place))
            yield replace(row, role=roles[at, place], p_primary=p, stars=significance_stars(p))

    return replace(family, rows=tuple(given()))


PRIMARY_COLUMN_HEADINGS = (
    "Question",
    "Quantity",
    "Groups",
    "n",
    "Medians",
    "Effect size [95 % CI]",
    "p",
    "p, corrected",
    "",
)
PRIMARY_NUMERIC_COLUMNS = (3, 4, 5, 6, 7)
PRIMARY_CAPTION = "Primary results; one value per participant; p corrected over all primary results"
WITHOUT_PLAN_TEXT = (
    "No plan names hypotheses. The primary results are therefore the tests by participant of differences between "
    "policies in each answer, score and objective measure, of the first answer against the midpoint of its scale, and "
    "of changes from before to after sessions."
)
WITH_PLAN_TEXT = (
    "The primary results are the tests of the hypotheses in the plan, with one value per participant."
)
OTHER_RESULTS_TEXT = (
    "Only primary results have stars, for p after correction over all of them: * < 0.05, ** < 0.01, *** < 0.001. All "
    "other results are sensitivity analyses, secondary or supplementary. Stars and figures use “p, corrected”. "
    "“p, Holm” in other tables is corrected within one family and therefore differs."
)


def primary_section(
    tests: Sequence[ComparisonRow], models: Sequence[ModelRow], simulated: bool, *, planned: bool
) -> Markup:
    """Returns the report section with the primary results of one group; empty without primary results.

    ``planned``: whether a confirmatory plan defines the primary results.
    """
    rows = primary_rows(tests, models, simulated)
    if not rows:
        return Markup()
    mark = [badge("SIMULATED PARTICIPANTS")] if simulated else []
    limits = [tag("p", words) for words in _limits(tests, models, simulated)]
    return tag(
        "section",
        tag("h3", "Primary results"),
        *mark,
        tag("p", f"{WITH_PLAN_TEXT if planned else WITHOUT_PLAN_TEXT} {OTHER_RESULTS_TEXT}"),
        *limits,
        table(
            group_caption(PRIMARY_CAPTION, simulated), PRIMARY_COLUMN_HEADINGS, rows, PRIMARY_NUMERIC_COLUMNS
        ),
    )


def primary_rows(
    tests: Sequence[ComparisonRow], models: Sequence[ModelRow], simulated: bool
) -> list[tuple[object, ...]]:
    """Returns the rows of the table of primary results: first tests, then model effects."""
    own_tests, own_models = _primary_of_group(tests, models, simulated)
    return [*map(_test_cells, own_tests), *map(_model_cells, own_models)]


def _primary_of_group(
    tests: Sequence[ComparisonRow], models: Sequence[ModelRow], simulated: bool
) -> tuple[list[ComparisonRow], list[ModelRow]]:
    def wanted(row: ComparisonRow | ModelRow) -> bool:
        return row.simulated is simulated and row.role == PRIMARY

    return list(filter(wanted, tests)), list(filter(wanted, models))


def _test_cells(row: ComparisonRow) -> tuple[object, ...]:
    return (
        row.family.removesuffix(f", by {PARTICIPANT_UNIT}"), row.quantity, f"{row.group_a} / {row.group_b}",
        sample_size_text(row), f"{short_number_text(row.median_a)} / {short_number_text(row.median_b)}",
        effect_size_text(row.effect, row.effect_low, row.effect_high),
        row.note if row.p is None else p_text(row.p), p_text(row.p_primary), row.stars,
    )  # fmt: skip


def _model_cells(row: ModelRow) -> tuple[object, ...]:
    return (
        row.family, row.quantity, f"{row.group_a} / {row.group_b}", row.participants, "–", effect_text(row),
        row.note if row.p is None else p_text(row.p), p_text(row.p_primary), row.stars,
    )  # fmt: skip


def _limits(tests: Sequence[ComparisonRow], models: Sequence[ModelRow], simulated: bool) -> Iterator[str]:
    """Yields notes about the limits of tests with few participants."""
    rows = [*chain(*_primary_of_group(tests, models, simulated))]
    if any(row.note == TOO_FEW_PARTICIPANTS_TEXT for row in rows):
        yield f"With fewer than {MIN_PARTICIPANTS} participants, results are described and not tested."
    elif number := _most_participants(rows):
        minimum = 2.0 / 2.0**number
        if minimum >= 0.05:
            yield f"With {number} participants, p of a paired test is at least {minimum:.3g}: no star is possible."


def _most_participants(rows: Sequence[ComparisonRow | ModelRow]) -> int:
    if any(isinstance(row, ModelRow) for row in rows):
        return 0
    return max((row.n_a for row in rows if isinstance(row, ComparisonRow)), default=0)
