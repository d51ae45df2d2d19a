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
from avrgym.analysis.models.regression_models import ModelEffectRow
from avrgym.analysis.models.section import format_effect
from avrgym.analysis.page.html_elements import (
    Markup,
    format_effect_size,
    format_group_caption,
    format_p_value,
    format_short_number,
    render_badge,
    render_table,
    tag,
)
from avrgym.analysis.page.hypothesis_test_tables import format_sample_size
from avrgym.analysis.statistics.comparisons import (
    MIN_PARTICIPANTS,
    PARTICIPANT_UNIT,
    PRIMARY_ROLE,
    SECONDARY_ROLE,
    SENSITIVITY_ANALYSIS_ROLE,
    SUPPLEMENT_ROLE,
    TOO_FEW_PARTICIPANTS_TEXT,
    TRIAL_UNIT,
    ComparisonFamily,
    ComparisonRow,
)
from avrgym.analysis.statistics.rank_tests import apply_holm_correction, format_significance_stars
from avrgym.analysis.statistics.sign_flips import compute_sign_flip_p_values
from avrgym.study.plan.analysis_plan import AnalysisPlan

TestIndex = tuple[int, int]
"""Index of a test: (index of the family, index of the row in the family)."""


@dataclass(frozen=True)
class ResultsWithRoles:
    """Tests and model effects with their roles (such as primary).

    Primary results also have a corrected p value and significance stars.
    """

    families: list[ComparisonFamily]
    model_rows: list[ModelEffectRow]


def assign_result_roles(
    families: Sequence[ComparisonFamily], models: Sequence[ModelEffectRow], plan: AnalysisPlan | None
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
            at
            for at, role in roles.items()
            if role == PRIMARY_ROLE and families[at[0]].is_simulated is simulated
        ]
        effects = [
            at
            for at, row in enumerate(models)
            if of_models[at] == PRIMARY_ROLE and row.simulated is simulated
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
                stars=format_significance_stars(of_effects.get(at)),
            )
            for at, row in enumerate(models)
        ],
    )


def _role_of_test(family: ComparisonFamily, row: ComparisonRow, plan: AnalysisPlan | None) -> str:
    """Returns the role of a test. If a hypothesis contains a test by trial, the test by participant is primary."""
    if row.unit == TRIAL_UNIT:
        return SUPPLEMENT_ROLE
    if plan is None:
        return PRIMARY_ROLE if family.question.is_primary else SECONDARY_ROLE
    named = (family.question.make_family_name(unit) for unit in (PARTICIPANT_UNIT, TRIAL_UNIT))
    return PRIMARY_ROLE if any(plan.find_hypotheses(name, row.quantity) for name in named) else SECONDARY_ROLE


def _role_of_effect(row: ModelEffectRow, plan: AnalysisPlan | None) -> str:
    if plan is not None and plan.find_hypotheses(row.family, row.quantity):
        return PRIMARY_ROLE
    return SENSITIVITY_ANALYSIS_ROLE if row.effect == POLICY_EFFECT else SECONDARY_ROLE


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
    found = [None if p is None else min(1.0, parts * p) for p in apply_holm_correction(others)]
    joint = compute_sign_flip_p_values([tests[at][1] for at in paired])
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
            yield replace(row, role=roles[at, place], p_primary=p, stars=format_significance_stars(p))

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
PRIMARY_TABLE_CAPTION = "Primary results; one value per participant; p corrected over all primary results"
PRIMARY_WITHOUT_PLAN_TEXT = (
    "No plan names hypotheses. The primary results are therefore the tests by participant of differences between "
    "policies in each answer, score and objective measure, of the first answer against the midpoint of its scale, and "
    "of changes from before to after sessions."
)
PRIMARY_WITH_PLAN_TEXT = (
    "The primary results are the tests of the hypotheses in the plan, with one value per participant."
)
OTHER_RESULTS_TEXT = (
    "Only primary results have stars, for p after correction over all of them: * < 0.05, ** < 0.01, *** < 0.001. All "
    "other results are sensitivity analyses, secondary or supplementary. Stars and figures use “p, corrected”. "
    "“p, Holm” in other tables is corrected within one family and therefore differs."
)


def render_primary_section(
    tests: Sequence[ComparisonRow], models: Sequence[ModelEffectRow], simulated: bool, *, planned: bool
) -> Markup:
    """Returns the report section with the primary results of one group; empty without primary results.

    ``planned``: whether a confirmatory plan defines the primary results.
    """
    rows = make_primary_rows(tests, models, simulated)
    if not rows:
        return Markup()
    mark = [render_badge("SIMULATED PARTICIPANTS")] if simulated else []
    limits = [tag("p", words) for words in _limits(tests, models, simulated)]
    return tag(
        "section",
        tag("h3", "Primary results"),
        *mark,
        tag("p", f"{PRIMARY_WITH_PLAN_TEXT if planned else PRIMARY_WITHOUT_PLAN_TEXT} {OTHER_RESULTS_TEXT}"),
        *limits,
        render_table(
            format_group_caption(PRIMARY_TABLE_CAPTION, simulated),
            PRIMARY_COLUMN_HEADINGS,
            rows,
            PRIMARY_NUMERIC_COLUMNS,
        ),
    )


def make_primary_rows(
    tests: Sequence[ComparisonRow], models: Sequence[ModelEffectRow], simulated: bool
) -> list[tuple[object, ...]]:
    """Returns the rows of the table of primary results: first tests, then model effects."""
    own_tests, own_models = _primary_of_group(tests, models, simulated)
    return [*map(_test_cells, own_tests), *map(_model_cells, own_models)]


def _primary_of_group(
    tests: Sequence[ComparisonRow], models: Sequence[ModelEffectRow], simulated: bool
) -> tuple[list[ComparisonRow], list[ModelEffectRow]]:
    def wanted(row: ComparisonRow | ModelEffectRow) -> bool:
        return row.simulated is simulated and row.role == PRIMARY_ROLE

    return list(filter(wanted, tests)), list(filter(wanted, models))


def _test_cells(row: ComparisonRow) -> tuple[object, ...]:
    return (
        row.family.removesuffix(f", by {PARTICIPANT_UNIT}"), row.quantity, f"{row.group_a} / {row.group_b}",
        format_sample_size(row), f"{format_short_number(row.median_a)} / {format_short_number(row.median_b)}",
        format_effect_size(row.effect, row.effect_low, row.effect_high),
        row.note if row.p is None else format_p_value(row.p), format_p_value(row.p_primary), row.stars,
    )  # fmt: skip


def _model_cells(row: ModelEffectRow) -> tuple[object, ...]:
    return (
        row.family, row.quantity, f"{row.group_a} / {row.group_b}", row.participants, "–", format_effect(row),
        row.note if row.p is None else format_p_value(row.p), format_p_value(row.p_primary), row.stars,
    )  # fmt: skip


def _limits(
    tests: Sequence[ComparisonRow], models: Sequence[ModelEffectRow], simulated: bool
) -> Iterator[str]:
    """Yields notes about the limits of tests with few participants."""
    rows = [*chain(*_primary_of_group(tests, models, simulated))]
    if any(row.note == TOO_FEW_PARTICIPANTS_TEXT for row in rows):
        yield f"With fewer than {MIN_PARTICIPANTS} participants, results are described and not tested."
    elif number := _most_participants(rows):
        minimum = 2.0 / 2.0**number
        if minimum >= 0.05:
            yield f"With {number} participants, p of a paired test is at least {minimum:.3g}: no star is possible."


def _most_participants(rows: Sequence[ComparisonRow | ModelEffectRow]) -> int:
    if any(isinstance(row, ModelEffectRow) for row in rows):
        return 0
    return max((row.n_a for row in rows if isinstance(row, ComparisonRow)), default=0)
