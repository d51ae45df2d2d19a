"""Simulated results of studies with differences between participants, for tests of models."""

import numpy as np

from avrgym.analysis.models.effects import TrialValue
from avrgym.analysis.power.power_simulation import order_trial_values
from avrgym.analysis.power.simulated_studies import PowerAssumptions, SimulatedStudies
from avrgym.array_types import FloatArray
from avrgym.study.design.allocation import make_trial_orders
from avrgym.study.design.design import Design


def trial_values(design: Design, values: FloatArray) -> list[TrialValue]:
    """Return the trials of a study with values (participants, tasks, robots, policies)."""
    orders = make_trial_orders(design)
    return order_trial_values(design, values, [orders[number % len(orders)] for number in range(len(values))])


def simulated_answers(
    design: Design, participants: int, number: int, effect: float = 0.0, **spread: float
) -> list[TrialValue]:
    """Return answers to the first item as ``avrgym study power`` simulates them, without withdrawals."""
    studies = SimulatedStudies(design, PowerAssumptions(dropout=0.0, **spread), 0)
    return trial_values(design, studies.simulate_answers(effect, participants, number)[..., 0].astype(float))


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
    """Return rewards without an effect of policies."""
    return trial_values(design, latent_values(design, participants, number))


def simulated_successes(design: Design, participants: int, number: int) -> list[TrialValue]:
    """Return successes without an effect of policies. The rate is above 0.5."""
    return trial_values(design, (latent_values(design, participants, number, 0.4) > 0.0).astype(float))
