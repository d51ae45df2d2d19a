"""Empirical-Bayes shrinkage of estimates to the mean of their group.

The estimates are x_i = θ_i + e_i, with e_i ~ N(0, s_i²) and θ_i ~ N(μ, τ²). The variance τ² between participants is the
estimate of Paule and Mandel (J. Res. Natl. Bur. Stand. 87:377, 1982): the τ² with

    Σ (x_i - μ)² / (τ² + s_i²) = n - 1,  μ = Σ x_i / (τ² + s_i²) / Σ 1 / (τ² + s_i²).

The posterior distribution of θ_i is normal. With B_i = s_i² / (s_i² + τ²), its mean is x_i + B_i (μ - x_i), and its
variance is (1 - B_i) s_i² + B_i² var(μ) (Morris, J. Am. Stat. Assoc. 78:47, 1983).
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize

from avrgym.array_types import FloatArray


class Shrunken(NamedTuple):
    """Posterior means and standard deviations (n,), and mean and standard deviation of the group."""

    mean: FloatArray
    deviation: FloatArray
    group_mean: float
    group_deviation: float


def shrink(estimates: FloatArray, variances: FloatArray) -> Shrunken:
    """Returns the posterior distributions of n parameters from their estimates (n,) and sampling variances (n,)."""

    def weighted(between: float) -> tuple[FloatArray, float]:
        weights = 1.0 / (between + variances)
        return weights, float(weights @ estimates / weights.sum())

    def excess(between: float) -> float:
        weights, mean = weighted(between)
        return float(weights @ (estimates - mean) ** 2) - (len(estimates) - 1)

    variances = np.maximum(variances, 1e-12)
    most = float(np.ptp(estimates)) ** 2 + 1e-9
    between = float(optimize.brentq(excess, 0.0, most)) if excess(0.0) > 0.0 else 0.0
    weights, mean = weighted(between)
    share = variances / (variances + between)
    posterior = (1.0 - share) * variances + share**2 / weights.sum()
    return Shrunken(estimates + share * (mean - estimates), np.sqrt(posterior), mean, float(np.sqrt(between)))
