"""Proportional odds models of ordinal answers, with participants as clusters; for two categories, logistic regression.

P(Y ≤ k) = 1 / (1 + exp(x β − θ_k)) (McCullagh, J. R. Statist. Soc. B 42, 1980). A positive β makes higher answers more
probable; exp(β) is an odds ratio. Generalised estimating equations with independence as the working correlation give
the estimates. The covariance is robust to any dependence within a participant (Liang and Zeger, Biometrika 73, 1986),
but too small for few participants. The residuals of each participant are therefore divided by (1 − leverage)
(Mancl and DeRouen, Biometrics 57, 2001), or by √(1 − leverage) (Kauermann and Carroll, J. Am. Statist. Assoc. 96,
2001).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from avrgym.analysis.models.estimate import EffectEstimate, ModelFitError
from avrgym.array_types import FloatArray, IntArray

MAX_ITERATIONS = 60
CONVERGENCE_TOLERANCE = 1e-12
NOT_IDENTIFIED_TEXT = "not all effects are identifiable from the values"
MAX_LOG_ODDS = 12.0
"""Effects above this limit (in log odds) are considered unbounded, because the groups are separated."""
NO_LEVERAGE_CORRECTION, KAUERMANN_CARROLL_CORRECTION, MANCL_DEROUEN_CORRECTION = 0.0, 0.5, 1.0
"""Corrections of the covariance: residuals are divided by (1 − leverage) to the power of this exponent."""


@dataclass(frozen=True, eq=False)
class OrdinalModelFit:
    """Fitted proportional odds model.

    ``category_thresholds`` (k,): thresholds between categories, in log odds. ``coefficients`` (p,),
    ``coefficient_covariance`` (p, p): coefficients and their covariance. ``cluster_count``: number of clusters.
    """

    category_thresholds: FloatArray
    coefficients: FloatArray
    coefficient_covariance: FloatArray
    cluster_count: int

    def estimate(self, contrast: FloatArray) -> EffectEstimate:
        """Returns the estimate of a contrast (p,) in log odds. Student's t has (clusters − 1) degrees of freedom."""
        variance = float(contrast @ self.coefficient_covariance @ contrast)
        return EffectEstimate.from_variance(
            float(contrast @ self.coefficients), variance, self.cluster_count - 1
        )


def fit_ordinal_model(
    values: ArrayLike,
    design: FloatArray,
    clusters: ArrayLike,
    correction: float = KAUERMANN_CARROLL_CORRECTION,
) -> OrdinalModelFit:
    """Returns a proportional odds model, fitted to answers (n,).

    Args:
        values: the answers (n,).
        design: the design matrix (n, p) without intercept.
        clusters: cluster of each answer (n,).
        correction: the exponent in the correction of the covariance for few clusters.

    Raises:
        ModelFitError: if all answers are equal, an effect is unbounded, or one cluster alone determines an effect.
    """
    levels, answered = np.unique(np.asarray(values), return_inverse=True)
    if len(levels) < 2:
        raise ModelFitError("all values are equal; a model needs different values")
    thresholds = len(levels) - 1
    parameters = _most_likely(answered, design, thresholds)
    _, scores, information = _derivatives(parameters, answered, design, thresholds)
    names, members = np.unique(np.asarray(clusters), return_inverse=True)
    of_cluster: FloatArray = np.eye(len(names))[:, members]
    covariance = compute_clustered_covariance(
        of_cluster @ scores, np.einsum("cn,nij->cij", of_cluster, information), correction
    )[thresholds:, thresholds:]
    return OrdinalModelFit(parameters[:thresholds], parameters[thresholds:], covariance, len(of_cluster))


def compute_clustered_covariance(
    scores: FloatArray, information: FloatArray, correction: float
) -> FloatArray:
    """Returns the cluster-robust covariance (p, p) of the estimates.

    ``scores`` (c, p) and ``information`` (c, p, p): score and expected information of each cluster. The leverage of a
    cluster is Lᵀ I L. I is the information of the cluster, and L Lᵀ is the inverse of the total information.
    """
    root = _root_of_inverse(information.sum(axis=0))
    leverage: FloatArray = root.T @ information @ root
    shares, axes = np.linalg.eigh(leverage)
    left = 1.0 - shares
    if correction and left.min() < 1e-9:
        raise ModelFitError("one participant alone determines an effect; use the test by participant")
    along: FloatArray = np.einsum("cij,ci->cj", axes, scores @ root) * left**-correction
    corrected: FloatArray = np.einsum("cij,cj->ci", axes, along) @ root.T
    return corrected.T @ corrected


def _root_of_inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.linalg.cholesky(np.linalg.inv(matrix))
    except np.linalg.LinAlgError as error:
        raise ModelFitError(NOT_IDENTIFIED_TEXT) from error


def _most_likely(answered: IntArray, design: FloatArray, thresholds: int) -> FloatArray:
    """Returns the maximum likelihood estimates (thresholds, then coefficients), by Fisher scoring."""
    below = np.array([np.mean(answered <= k) for k in range(thresholds)])
    parameters: FloatArray = np.concatenate([np.log(below / (1.0 - below)), np.zeros(design.shape[1])])
    likelihood, scores, information = _derivatives(parameters, answered, design, thresholds)
    for _ in range(MAX_ITERATIONS):
        score = scores.sum(axis=0)
        step = _solved(information.sum(axis=0), score)
        if score @ step < CONVERGENCE_TOLERANCE:
            return parameters
        tried = _derivatives(parameters + step, answered, design, thresholds)
        while tried[0] < likelihood and np.abs(step).max() > 1e-12:
            step = step / 2.0
            tried = _derivatives(parameters + step, answered, design, thresholds)
        parameters, (likelihood, scores, information) = parameters + step, tried
        if np.abs(parameters[thresholds:]).max(initial=0.0) > MAX_LOG_ODDS:
            break
    raise ModelFitError(
        "complete separation: all values of a group are at one end of the scale, so its effect is unbounded; "
        "use the test by participant"
    )


def _solved(information: FloatArray, score: FloatArray) -> FloatArray:
    try:
        return np.linalg.solve(information, score)
    except np.linalg.LinAlgError as error:
        raise ModelFitError(NOT_IDENTIFIED_TEXT) from error


def _derivatives(
    parameters: FloatArray, answered: IntArray, design: FloatArray, thresholds: int
) -> tuple[float, FloatArray, FloatArray]:
    """Returns the log-likelihood of all answers, and score (n, q) and expected information (n, q, q) of each answer.

    The log-likelihood is −∞ if the thresholds are not in order.
    """
    count, width = design.shape
    below = 0.5 + 0.5 * np.tanh(0.5 * (parameters[:thresholds] - (design @ parameters[thresholds:])[:, None]))
    edges = np.hstack([np.zeros((count, 1)), below, np.ones((count, 1))])
    shares = np.diff(edges, axis=1)
    slopes = np.zeros((count, thresholds + 2, thresholds + width))
    density = below * (1.0 - below)
    slopes[:, np.arange(thresholds) + 1, np.arange(thresholds)] = density
    slopes[:, 1:-1, thresholds:] = -density[:, :, None] * design[:, None, :]
    slopes = np.diff(slopes, axis=1)
    if not shares.min() > 0.0:
        return -np.inf, slopes[:, 0], np.zeros((count, *slopes.shape[2:], slopes.shape[2]))
    weighted = slopes / shares[:, :, None]
    rows = np.arange(len(design))
    likelihood = float(np.log(shares[rows, answered]).sum())
    return likelihood, weighted[rows, answered], np.einsum("nki,nkj->nij", weighted, slopes)
