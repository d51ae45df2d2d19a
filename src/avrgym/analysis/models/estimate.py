"""Estimates of effects from fitted regression models."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy import stats

from avrgym.array_types import FloatArray

CONFIDENCE_LEVEL = 0.95


class ModelFitError(Exception):
    """The model or the effect cannot be estimated from these data."""


@dataclass(frozen=True)
class EffectEstimate:
    """Estimate of an effect: value, standard error, 95 % confidence interval, and p value of a t test.

    ``df``: degrees of freedom of Student's t. ``note``: warnings about the model; empty without warnings.
    """

    value: float
    standard_error: float
    df: float
    ci_low: float
    ci_high: float
    p: float
    note: str = ""

    @classmethod
    def from_variance(cls, value: float, variance: float, df: float) -> "EffectEstimate":
        """Returns an estimate with 95 % confidence interval and p value by Student's t.

        Raises ``ModelFitError`` if the variance is not above 0.
        """
        if not variance > 1e-16 * max(1.0, value**2):
            raise ModelFitError(
                "all participants have the same difference: its variance is zero; use the test by participant"
            )
        error = float(np.sqrt(variance))
        half = float(stats.t.ppf(0.5 + CONFIDENCE_LEVEL / 2, df)) * error
        p = 2.0 * float(stats.t.sf(abs(value) / error, df))
        return cls(value, error, df, value - half, value + half, p)


class FittedModel(Protocol):
    """Interface of fitted regression models: estimates of linear combinations of the coefficients."""

    def estimate(self, contrast: FloatArray) -> EffectEstimate:
        """Returns the estimate of ``contrast @ coefficients``. ``contrast`` (p,): weight of each coefficient."""
        ...
