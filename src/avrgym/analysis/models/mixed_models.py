"""Linear mixed models with random effects of participants and conditions.

y = X β + e. The covariance of the values in a cluster is Σ_a σ_a² G_a, with variance components σ_a² and known matrices
G_a. The variances are estimated by restricted maximum likelihood (Patterson and Thompson, Biometrika 58, 1971) with
Fisher scoring. A variance can be negative if all covariances remain positive definite. With a lower bound of zero,
tests with few participants would have too many false positives. Standard errors and degrees of freedom are computed by
the method of Kenward and Roger (Biometrics 53, 1997). For a single effect, the degrees of freedom are Satterthwaite's,
and the variance is from the adjusted covariance.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from avrgym.analysis.models.estimate import EffectEstimate, ModelFitError
from avrgym.array_types import FloatArray

MAX_ITERATIONS = 30
MAX_STEP_HALVINGS = 8
CONVERGENCE_TOLERANCE = 1e-10
MAX_SINGULAR_VARIANCE_RATIO = 1e-8
"""A random-effect variance is considered zero if it is at most this share of the residual variance."""
NOT_CONVERGED_TEXT = "variance between participants cannot be separated from variance within participants"


@dataclass(frozen=True, eq=False)
class MixedModelFit:
    """Fitted linear mixed model: coefficients (p,), variance components (v,), and covariances.

    ``variance_components``: one for each random effect, then the residual variance. ``coefficient_covariance`` (p, p):
    covariance of the coefficients, without the uncertainty of the variances; ``adjusted_coefficient_covariance`` (p,
    p) includes it. ``covariance_derivatives`` (v, p, p): derivatives of ``coefficient_covariance`` with respect to
    each variance. ``variance_components_covariance`` (v, v): covariance of the estimated variances.
    """

    coefficients: FloatArray
    variance_components: FloatArray
    coefficient_covariance: FloatArray
    adjusted_coefficient_covariance: FloatArray
    covariance_derivatives: FloatArray
    variance_components_covariance: FloatArray

    @property
    def zero_variance_indices(self) -> list[int]:
        """Returns the indices of random effects with zero or negative variance.

        With such an effect, the fit is singular.
        """
        *groups, single = self.variance_components.tolist()
        return [
            place
            for place, variance in enumerate(groups)
            if variance <= MAX_SINGULAR_VARIANCE_RATIO * abs(single)
        ]

    def estimate(self, contrast: FloatArray) -> EffectEstimate:
        """Returns the estimate of a contrast (p,), by Student's t."""
        plain = float(contrast @ self.coefficient_covariance @ contrast)
        gradient = np.einsum("i,vij,j->v", contrast, self.covariance_derivatives, contrast)
        spread = float(gradient @ self.variance_components_covariance @ gradient)
        if not spread > 0.0:
            raise ModelFitError(NOT_CONVERGED_TEXT)
        value = float(contrast @ self.coefficients)
        return EffectEstimate.from_variance(
            value, float(contrast @ self.adjusted_coefficient_covariance @ contrast), 2.0 * plain**2 / spread
        )


@dataclass(frozen=True, eq=False)
class _Cluster:
    """The n values of one cluster, their design matrix (n, p), and ``parts`` (v, n, n): the matrix G_a of each
    variance."""

    values: FloatArray
    design_matrix: FloatArray
    parts: FloatArray


@dataclass(frozen=True, eq=False)
class _State:
    """Restricted log-likelihood, score (v,), information (v, v) and estimates at given variances (v,)."""

    likelihood: float
    score: FloatArray
    information: FloatArray
    coefficients: FloatArray
    covariance: FloatArray
    singles: FloatArray
    pairs: FloatArray


def fit_mixed_model(
    values: ArrayLike, design_matrix: FloatArray, clusters: ArrayLike, groupings: Sequence[ArrayLike]
) -> MixedModelFit:
    """Returns a linear mixed model, fitted to values (n,).

    Args:
        values: the dependent variable (n,).
        design_matrix: the design matrix (n, p) of the fixed effects, with an intercept.
        clusters: cluster of each value (n,); values of different clusters are independent.
        groupings: an array for each random effect. Labels (n,): values with equal labels have the same random
            intercept. Covariates (n, k): random slopes with one common variance.

    Raises:
        ModelFitError: if effects or variances cannot be estimated from the values.
    """
    given = np.asarray(values, float)
    if np.ptp(given) == 0.0:
        raise ModelFitError("all values are equal; a model needs different values")
    if np.linalg.matrix_rank(design_matrix) < design_matrix.shape[1] or len(given) <= design_matrix.shape[1]:
        raise ModelFitError(
            "not all effects are identifiable: the design matrix is rank-deficient, or there are too few values; "
            "use the test by participant"
        )
    scale = float(given.std())
    own = list(_clusters(given / scale, design_matrix, np.asarray(clusters), groupings))
    state, variances = _maximise_likelihood(own, len(groupings) + 1)
    variance_covariance = _inverse(state.information)
    bend = state.pairs - np.einsum("aij,jk,bkl->abil", state.singles, state.covariance, state.singles)
    middle = np.einsum("ab,abij->ij", variance_covariance, bend)
    adjusted = state.covariance + 2.0 * state.covariance @ middle @ state.covariance
    covariance_derivatives = state.covariance @ state.singles @ state.covariance
    return MixedModelFit(
        scale * state.coefficients,
        scale**2 * variances,
        scale**2 * state.covariance,
        scale**2 * adjusted,
        covariance_derivatives,
        scale**4 * variance_covariance,
    )


def _clusters(
    values: FloatArray, design_matrix: FloatArray, clusters: FloatArray, groupings: Sequence[ArrayLike]
) -> list[_Cluster]:
    found: list[_Cluster] = []
    for name in np.unique(clusters):
        own = clusters == name
        parts = [_part(np.asarray(grouping)[own]) for grouping in groupings]
        found.append(_Cluster(values[own], design_matrix[own], np.array([*parts, np.eye(int(own.sum()))])))
    return found


def _part(grouping: FloatArray) -> FloatArray:
    """Returns G_a (n, n) of a random effect in one cluster: 1 for equal labels, or Z Zᵀ for covariates Z."""
    if grouping.ndim == 1:
        return (grouping[:, None] == grouping).astype(float)
    return grouping @ grouping.T


def _maximise_likelihood(clusters: Sequence[_Cluster], count: int) -> tuple[_State, FloatArray]:
    """Returns state and variances (v,) at the maximum of the restricted likelihood. ``count``: number of variances
    v."""
    variances = np.full(count, 0.5 / max(count - 1, 1))
    variances[-1] = 0.5
    state = _state(clusters, variances)
    for _ in range(MAX_ITERATIONS):
        if state is None:
            break
        step = _inverse(state.information) @ state.score
        if state.score @ step < CONVERGENCE_TOLERANCE:
            return state, variances
        variances, state = _take_step(clusters, variances, state, step)
    raise ModelFitError(NOT_CONVERGED_TEXT)


def _take_step(
    clusters: Sequence[_Cluster], variances: FloatArray, state: _State, step: FloatArray
) -> tuple[FloatArray, _State | None]:
    """Returns variances and state after a step. The step is halved until the likelihood does not decrease.

    If the likelihood still decreases after ``MAX_STEP_HALVINGS`` attempts, variances are unchanged and the state is
    ``None``.
    """
    for _ in range(MAX_STEP_HALVINGS):
        tried = _state(clusters, variances + step)
        if tried is not None and tried.likelihood >= state.likelihood - 1e-12:
            return variances + step, tried
        step = step / 2.0
    return variances, None


def _state(clusters: Sequence[_Cluster], variances: FloatArray) -> _State | None:
    """Returns the state at ``variances`` (v,); ``None`` if a cluster's covariance is not positive definite.

    W is the inverse of a cluster's covariance, G_a the matrix of variance a. ``singles`` is the sum of Xᵀ W G_a W X
    over clusters, ``pairs`` the sum of Xᵀ W G_a W G_b W X.
    """
    weights: list[FloatArray] = []
    determinant = 0.0
    for each in clusters:
        covariance = np.tensordot(variances, each.parts, 1)
        try:
            root = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError:
            return None
        if root.diagonal().min() < 1e-6:
            return None
        determinant += 2.0 * float(np.log(root.diagonal()).sum())
        weights.append(np.linalg.inv(covariance))
    own = list(zip(clusters, weights, strict=True))
    covariance = _inverse(np.sum([each.design_matrix.T @ w @ each.design_matrix for each, w in own], axis=0))
    coefficients = covariance @ np.sum([each.design_matrix.T @ w @ each.values for each, w in own], axis=0)
    return _derived(clusters, weights, determinant, coefficients, covariance)


def _derived(
    clusters: Sequence[_Cluster],
    weights: Sequence[FloatArray],
    determinant: float,
    coefficients: FloatArray,
    covariance: FloatArray,
) -> _State:
    count, width = len(clusters[0].parts), len(coefficients)
    traces, squares = np.zeros(count), np.zeros(count)
    both = np.zeros((count, count))
    singles, pairs = np.zeros((count, width, width)), np.zeros((count, count, width, width))
    residual = 0.0
    for each, w in zip(clusters, weights, strict=True):
        left = each.values - each.design_matrix @ coefficients
        pulled = w @ left
        turned = each.parts @ w
        around = w @ each.design_matrix
        spread = each.parts @ around
        residual += float(left @ pulled)
        squares += np.einsum("i,aij,j->a", pulled, each.parts, pulled)
        traces += np.einsum("aii->a", turned)
        both += np.einsum("aij,bji->ab", turned, turned)
        singles += np.einsum("ni,anj->aij", around, spread)
        pairs += np.einsum("ani,nm,bmj->abij", spread, w, spread, optimize=True)
    leaning = covariance @ singles
    traces -= np.einsum("aii->a", leaning)
    both += np.einsum("aij,bji->ab", leaning, leaning) - 2.0 * np.einsum("ij,abji->ab", covariance, pairs)
    likelihood = -0.5 * (determinant - float(np.linalg.slogdet(covariance)[1]) + residual)
    return _State(likelihood, 0.5 * (squares - traces), 0.5 * both, coefficients, covariance, singles, pairs)


def _inverse(matrix: FloatArray) -> FloatArray:
    try:
        return np.linalg.inv(matrix)
    except np.linalg.LinAlgError as error:
        raise ModelFitError(NOT_CONVERGED_TEXT) from error
