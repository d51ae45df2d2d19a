"""The models on the page: each effect with its interval, and what becomes of it without one participant."""

from collections.abc import Sequence
from math import exp

from avrgym.analysis.models.effects import EFFECTS, POLICIES
from avrgym.analysis.models.models import ModelRow
from avrgym.analysis.page.comparisons import p_primary_text
from avrgym.analysis.page.elements import Markup, badge, number_text, p_text, table, tag
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS
from avrgym.study.plan.plan import EXPLORATORY

TITLES = {
    "policies": "Policies",
    "robots": "Robots",
    "learning": "Learning: by when a task came in the session",
    "order": "Order: by when a trial came within its task",
    "carry-over": "Carry-over: by the policy of the trial before",
}
NOTE = (
    "Each model allows for policy, robot, task, the place in the session and the trial before, and takes the trials of "
    "a participant as belonging together. Effects on answers and success are odds ratios: above 1, higher answers or "
    "successes are likelier with the first group. Effects on rewards and scores are in their own units. Intervals "
    "and p are by Student's t and corrected for few participants. Estimates without one participant show whether a "
    "result hangs on a single person."
)


def models_section(models: Sequence[ModelRow], simulated: bool) -> Markup:
    """The models of a group of participants, policies first; nothing where nothing was measured."""
    own = [row for row in models if row.simulated is simulated]
    kinds = [kind for kind in EFFECTS if any(row.effect == kind for row in own)]
    head = tag("h3", "Models with participants as clusters")
    reasons = {row.note for row in own if row.estimate is None}
    if not kinds:
        return Markup()
    if len(reasons) == 1 and all(row.estimate is None for row in own):
        return tag("section", head, tag("p", f"Nothing was modelled: {reasons.pop()}."))
    shown = {kind: _kind(kind, [row for row in own if row.effect == kind], simulated) for kind in kinds}
    others = [tag("details", tag("summary", TITLES[kind]), shown[kind]) for kind in kinds if kind != POLICIES]
    mark = [badge("SIMULATED PARTICIPANTS")] if simulated else []
    first = [shown[POLICIES]] if POLICIES in shown else []
    return tag("section", head, *mark, tag("p", NOTE), *first, *others)


def _kind(kind: str, rows: Sequence[ModelRow], simulated: bool) -> Markup:
    return table_of_effects(f"Models, {TITLES[kind][0].lower()}{TITLES[kind][1:]}", rows, simulated)


def table_of_effects(caption: str, rows: Sequence[ModelRow], simulated: bool) -> Markup:
    """Effects as a table; those that could not be estimated say why. Columns that say the same everywhere go."""
    corrected = any(row.p_primary is not None for row in rows)
    planned, noted = any(row.planned != EXPLORATORY for row in rows), any(row.note for row in rows)
    heads = (
        "What", "Groups", "People", "Effect [95 %]", "p", "p, Holm", *(["p, corrected"] if corrected else []),
        "Without one", "p then", "Role",
        *(["By plan"] if planned else []), *(["Remark"] if noted else []),
    )  # fmt: skip
    body = [
        (
            row.quantity, f"{row.group_a} / {row.group_b}", row.participants, effect_text(row), p_text(row.p),
            p_text(row.p_holm), *([p_primary_text(row.p_primary)] if corrected else []),
            _without_one(row), _probabilities(row), row.role,
            *([row.planned] if planned else []), *([row.note] if noted else []),
        )
        for row in rows
    ]  # fmt: skip
    marked = (
        caption
        + ("" if planned else "; all exploratory")
        + (" (simulated participants)" if simulated else "")
    )
    return table(marked, heads, body, numbers=range(2, 9 if corrected else 8))


def effect_text(row: ModelRow) -> str:
    """An effect with its interval: an odds ratio, or a difference."""
    if row.odds_ratio is not None:
        return f"{_ratio(row.odds_ratio)} × [{_ratio(row.odds_ratio_low)}, {_ratio(row.odds_ratio_high)}]"
    if row.estimate is None:
        return "–"
    return f"{number_text(row.estimate)} [{number_text(row.low)}, {number_text(row.high)}]"


def _ratio(value: float | None) -> str:
    """An odds ratio, of which nobody reads more than three digits."""
    if value is None:
        return "–"
    return (
        "> 999"
        if value > 999
        else "< 0.01"
        if value < 0.01
        else f"{value:.2f}"
        if value < 100
        else f"{value:.0f}"
    )


def _without_one(row: ModelRow) -> str:
    """From which estimate to which, in the unit of the effect."""
    least, most = row.without_one_least, row.without_one_most
    if least is None or most is None:
        return "–"
    if row.odds_ratio is not None:
        return f"{_ratio(exp(least))} to {_ratio(exp(most))} ×"
    return f"{number_text(least)} to {number_text(most)}"


def _probabilities(row: ModelRow) -> str:
    least, most = row.without_one_p_least, row.without_one_p_most
    return "–" if least is None else f"{p_text(least)} to {p_text(most)}"


MODELS_METHOD = (
    "Models: proportional odds for ordered answers and logistic regression for success, by estimating equations with "
    "participants as clusters, Kauermann and Carroll's covariance for few of them, and Student's t with one degree of "
    "freedom less than participants; for rewards, scores and long scales a linear mixed model in which participants "
    "differ in general, by policy, by robot and by task, with Kenward and Roger's standard errors and degrees of "
    "freedom. A mixed model with a random effect whose variance is zero or negative is marked as singular. "
    f"Fewer than {MIN_PARTICIPANTS} participants are not modelled. Tasks and robots with all values at the "
    "same end of a scale are left out, and named. Models are exploratory unless a frozen plan names them.",
)
