"""Estimates from fitted models."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import stats

from avrgym.array_types import FloatArray

CONFIDENCE_LEVEL = 0.95


class FitError(Exception):
    """The data do not identify the model or the effect."""


@dataclass(frozen=True)
class Estimate:
    """Estimate of an effect with standard error, degrees of freedom (Student's t), 95 % confidence interval and p.

    ``note``: warnings about the model, or empty.
    """

    value: float
    error: float
    df: float
    low: float
    high: float
    p: float
    note: str = ""

    @classmethod
    def from_variance(cls, value: float, variance: float, df: float) -> "Estimate":
        """Interval and p of an estimate by Student's t. Raises ``FitError`` if the variance is not positive."""
        if not variance > 1e-16 * max(1.0, value**2):
            raise FitError("all participants have the same difference: its variance is zero")
        error = float(np.sqrt(variance))
        half = float(stats.t.ppf(0.5 + CONFIDENCE_LEVEL / 2, df)) * error
        p = 2.0 * float(stats.t.sf(abs(value) / error, df))
        return cls(value, error, df, value - half, value + half, p)


class FittedModel(Protocol):
    """A fitted model."""

    def estimate(self, contrast: FloatArray) -> Estimate:
        """Estimate of ``contrast @ coefficients``; contrast (p,) belongs to the columns of the design matrix."""
        ...
