"""Empirical-Bayes shrinkage of estimates to the mean of their group.

The estimates are x_i = θ_i + e_i, with e_i ~ N(0, s_i²) and θ_i ~ N(μ, τ²). The variance τ² between participants is
estimated by the method of Paule and Mandel (J. Res. Natl. Bur. Stand. 87:377, 1982). τ² solves the equation

    Σ (x_i - μ)² / (τ² + s_i²) = n - 1,  μ = Σ x_i / (τ² + s_i²) / Σ 1 / (τ² + s_i²).

The posterior distribution of θ_i is approximated by a normal distribution with mean x_i + B_i (μ - x_i) and variance

    (1 - B_i) s_i² + B_i² var(μ) + 2 / (n - 3) B_i² (x_i - μ)² (mean(s²) + τ²) / (s_i² + τ²),
    B_i = (n - 3) / (n - 1) s_i² / (s_i² + τ²).

The factor of B_i and the last term account for the uncertainty of τ² (Morris, J. Am. Stat. Assoc. 78:47, 1983).
Estimates of three or fewer participants are not shrunk.
"""

from typing import NamedTuple

import numpy as np
from scipy import optimize

from avrgym.array_types import FloatArray


class ShrunkenEstimates(NamedTuple):
    """Posterior means (n,) and standard deviations (n,), and mean and standard deviation of the group."""

    posterior_mean: FloatArray
    posterior_sd: FloatArray
    group_mean: float
    group_sd: float


def shrink_estimates(estimates: FloatArray, variances: FloatArray) -> ShrunkenEstimates:
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
    count = len(estimates)
    share = max(count - 3, 0) / (count - 1) * variances * weights
    posterior = (1.0 - share) * variances + share**2 / weights.sum()
    if count > 3:
        unequal = (variances.mean() + between) * weights
        posterior = posterior + 2.0 / (count - 3) * share**2 * (estimates - mean) ** 2 * unequal
    return ShrunkenEstimates(
        estimates + share * (mean - estimates), np.sqrt(posterior), mean, float(np.sqrt(between))
    )
