"""The model of simulated answers, which tests whether policies differ."""

from collections.abc import Iterator, Sequence

from avrgym.analysis.power.answers import Answers
from avrgym.analysis.statistics.models.effects import POLICIES, Effect, Observed
from avrgym.analysis.statistics.models.fitted import Estimate
from avrgym.analysis.statistics.models.fitting import estimates
from avrgym.analysis.statistics.models.quantities import sources
from avrgym.array_types import FloatArray
from avrgym.study.design.counterbalancing import Order
from avrgym.study.design.design import Design


def modelled(design: Design, answers: Answers, orders: Sequence[Order]) -> tuple[str, float | None]:
    """The family of the model of the first item after trials, and p of the last policy against the first.

    p is ``None`` where the answers do not determine the model.
    """
    source = next(sources(design))
    model = next(iter(source.models.values()))
    wanted = Effect(POLICIES, design.policies[-1], design.policies[0])
    found = estimates(design, model, in_order(design, answers[..., 0].astype(float), orders), [wanted])
    estimate = found[wanted]
    return source.family(POLICIES), estimate.p if isinstance(estimate, Estimate) else None


def in_order(design: Design, values: FloatArray, orders: Sequence[Order]) -> list[Observed]:
    """The trials with values (participants, tasks, robots, policies), each participant in an order."""
    return [
        observed
        for number, (own, order) in enumerate(zip(values, orders, strict=True), start=1)
        for observed in _course(design, order, f"sub-{number:03}", own)
    ]


def _course(design: Design, order: Order, who: str, own: FloatArray) -> Iterator[Observed]:
    blocks, places = max(len(design.tasks) - 1, 1), max(len(design.conditions) - 1, 1)
    for block, part in enumerate(order):
        before = design.practice_policy or None
        for place, index in enumerate(part.conditions):
            robot, policy = design.conditions[index]
            value = own[part.task].reshape(-1)[index]
            task = design.tasks[part.task]
            yield Observed(who, task, robot, policy, block / blocks, place / places, before, float(value))
            before = policy
