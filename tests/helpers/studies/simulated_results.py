"""Imagined studies for tests of models: values of participants who differ, in the orders of a design."""

import numpy as np

from avrgym.analysis.models.effects import TrialValue
from avrgym.analysis.power.power import values_in_order
from avrgym.analysis.power.simulated_studies import Assumptions, SimulatedStudies
from avrgym.array_types import FloatArray
from avrgym.study.design.allocation import cell_orders
from avrgym.study.design.design import Design


def trial_values(design: Design, values: FloatArray) -> list[TrialValue]:
    """A study's trials with values (participants, tasks, robots, policies), each participant in the next order."""
    orders = cell_orders(design)
    return values_in_order(design, values, [orders[number % len(orders)] for number in range(len(values))])


def simulated_answers(
    design: Design, participants: int, number: int, effect: float = 0.0, **spread: float
) -> list[TrialValue]:
    """Answers to a design's first item as ``avrgym study power`` imagines them, nobody withdrawing."""
    studies = SimulatedStudies(design, Assumptions(dropout=0.0, **spread), 0)
    return trial_values(design, studies.answers(effect, participants, number)[..., 0].astype(float))


def latent_values(design: Design, participants: int, number: int, tendency: float = 0.0) -> FloatArray:
    """Latent values (participants, tasks, robots, policies): effects of participants, tasks and noise.

    Participants differ in general, in policies, in robots and in tasks.
    """
    rng = np.random.default_rng([7, number])
    shape = (participants, len(design.tasks), len(design.robots), len(design.policies))
    apart = [(0, 1.0), (3, 0.5), (2, 0.3), (1, 0.5)]
    values = tendency + rng.standard_normal(shape)
    for axis, deviation in apart:
        drawn = [size if along in (0, axis) else 1 for along, size in enumerate(shape)]
        values = values + deviation * rng.standard_normal(drawn)
    return values + rng.standard_normal((1, shape[1], 1, 1))


def simulated_rewards(design: Design, participants: int, number: int) -> list[TrialValue]:
    """Rewards without an effect of policies."""
    return trial_values(design, latent_values(design, participants, number))


def simulated_successes(design: Design, participants: int, number: int) -> list[TrialValue]:
    """Successes without an effect of policies: somewhat more than half."""
    return trial_values(design, (latent_values(design, participants, number, 0.4) > 0.0).astype(float))
