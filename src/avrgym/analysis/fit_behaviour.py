"""Fit behaviour parameters of the partner models in ``people.zoo`` to recorded motion.

For each participant, the movement parameters are robust least-squares estimates. The behaviour model of the zoo and the
motor model predict the motion from the recorded tool positions. The Levenberg-Marquardt method starts at the best point
of a grid. Sway and tremor are estimated from the periodogram of each trial and averaged over trials. All estimates are
then shrunk to the group mean, see ``statistics.shrinkage``.

Sampling variances are computed from differences between trials of one participant, or between the halves of a single
trial. The variances are pooled over participants. The variance of a least-squares estimate is first computed for
independent errors. It is then multiplied by the ratio of the jackknife variance to this variance (Efron, *The
Jackknife, the Bootstrap and Other Resampling Plans*, 1982). For a parameter found by grid search, the variance is
computed from the best value in each trial.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy import signal

from avrgym.analysis.recorded_motion import (
    ELBOW_COLUMN,
    HEAD_X_COLUMN,
    MOTION_JOINT_NAMES,
    WAIST_X_COLUMN,
    WAIST_Y_COLUMN,
    RecordedMotion,
)
from avrgym.analysis.statistics.shrinkage import ShrunkenEstimates, shrink_estimates
from avrgym.array_types import FloatArray
from avrgym.models.human import JOINT_INDEX, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, People
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.people import motor_model
from avrgym.people.motor_model import (
    MAX_JOINT_SPEED_RAD_S,
    NOISE_FREE_SPEED_FRACTION,
    STARTLE_FILTER_GAIN,
    STARTLE_SPEED_FACTOR,
)
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partners import DEFAULT_PARAMETER_BOUNDS, PARAMETER_BOUNDS, make_behaviour_parameters

MOVEMENT_PRIORS: Mapping[str, tuple[float, float]] = {
    "reaction_s": (0.35, 0.2),
    "facing_share": (0.5, 0.3),
    "approach_share": (0.7, 0.5),
    "speed_share": (0.9, 0.4),
    "startle_deg": (4.0, 8.0),
    "startle_distance_m": (0.2, 0.07),
    "startle_duration_s": (1.0, 0.5),
}
"""Mean and standard deviation of a weak prior, by movement parameter. The priors cover all partner models of the zoo.

A participant's trials may contain no information about a parameter, for example if the tool was never near the person.
The parameter then has the prior variance."""
RHYTHMIC_PARAMETERS = ("sway_deg", "sway_hz", "tremor_deg", "tremor_hz")
FITTED_PARAMETERS = (*MOVEMENT_PRIORS, *RHYTHMIC_PARAMETERS)
SWAY_FREQUENCY_STEP_HZ = 0.004
SWAY_BAND_HZ, TREMOR_BAND_HZ = (0.05, 0.6), (3.5, 12.0)
"""Frequency bands in which sway and tremor are searched. Tremor is between 4 and 12 Hz (Bhatia et al., Mov. Disord.
33:75, 2018)."""
_GRID = [
    {"reaction_s": reaction_s, "startle_deg": startle_deg, "startle_distance_m": startle_distance_m}
    for reaction_s in (0.2, 0.35, 0.55, 0.8)
    for startle_deg, startle_distance_m in ((0.5, 0.2), (10.0, 0.14), (10.0, 0.2), (10.0, 0.26))
]
_NAMES = tuple(MOVEMENT_PRIORS)
_STEPS = np.array([0.05, 0.02, 0.05, 0.05, 1.0, 0.02, 0.1])
"""Half-widths of the central differences, one for each parameter, in the parameter's unit. Observations are updated ten
times a second. The prediction is therefore a step function of reaction time and distances. With smaller half-widths,
the differences would measure the jumps of this function."""
_SEARCHED: Mapping[str, FloatArray] = {
    "reaction_s": 0.02 * np.arange(-10.0, 11.0),
    "speed_share": 0.05 * np.arange(-8.0, 9.0),
    "startle_distance_m": 0.005 * np.arange(-10.0, 11.0),
    "startle_duration_s": 0.05 * np.arange(-8.0, 9.0),
}
"""Changes to try in the grid search, by parameter.

The search is used for parameters with a small or discontinuous effect on the predictions.
"""
CAUCHY_WEIGHT_SCALE = 2.385
"""Scale of Cauchy's weight function, in standard deviations. Larger deviations have less weight (Holland and Welsch,
Commun. Stat. 6:813, 1977)."""
MAD_TO_SD_FACTOR = 1.4826
"""Standard deviation of normally distributed values, divided by their median absolute deviation."""
_MOVING = [JOINT_INDEX[name] for name in (*MOTION_JOINT_NAMES, "waist_z")]
_SHOWN = slice(len(MOTION_JOINT_NAMES))
SIDEWAYS_SWAY_FREQUENCY_RATIO = 0.7
"""Frequency of sideways sway divided by the frequency of forward sway, as in ``people.motor_model``."""
_STARTLE = [column for column, name in enumerate(_NAMES) if name.startswith("startle")]
_MEAN, _DEVIATION = np.array(list(MOVEMENT_PRIORS.values())).T
_LOW, _HIGH = np.array([PARAMETER_BOUNDS.get(name, DEFAULT_PARAMETER_BOUNDS) for name in _NAMES]).T
_EVERY = DEFAULT_SUBSTEPS // 2
"""Step between the samples for the least-squares method: every fifth angle, 20 angles a second."""
MOTION_LAG_TICKS = 1
"""Delay from a motion of the person to the joint targets, in ticks of 10 ms."""
FIT_COST_TOLERANCE = 0.5
"""Two least-squares costs are considered equal if their difference is below this value."""
ITERATIONS_PER_PASS = 3
"""Number of iterations in each of two passes: before and after the sway frequency is estimated."""
INITIAL_NOISE_STD_RAD, MIN_NOISE_STD_RAD = 0.01, 0.001
"""Initial and minimum standard deviation of the differences between recorded and predicted angles."""


@dataclass(frozen=True)
class FittedBehaviour:
    """Posterior distribution of each behaviour parameter, by parameter name; arrays in the order of
    ``participants``."""

    participants: tuple[str, ...]
    estimates_by_parameter: Mapping[str, ShrunkenEstimates]

    def list_participant_estimates(self) -> tuple[dict[str, tuple[float, float]], ...]:
        """Returns (posterior mean, posterior standard deviation) by parameter name, for each participant.

        Means are clipped to ``PARAMETER_BOUNDS``.
        """
        return tuple(
            {
                name: (
                    round(
                        float(
                            np.clip(
                                each.posterior_mean[row],
                                *PARAMETER_BOUNDS.get(name, DEFAULT_PARAMETER_BOUNDS),
                            )
                        ),
                        4,
                    ),
                    round(float(each.posterior_sd[row]), 4),
                )
                for name, each in self.estimates_by_parameter.items()
            }
            for row in range(len(self.participants))
        )


def fit_behaviour(motions: Sequence[RecordedMotion]) -> FittedBehaviour:
    """Returns the behaviour parameters of at least two participants, fitted to all their trials.

    A parameter is omitted if the trials of fewer than two participants contain information about it.
    """
    fit = _Fit(motions)
    fit.optimise()
    rhythms = fit.rhythms()
    fit.remove_sway(fit.means(rhythms)[:, RHYTHMIC_PARAMETERS.index("sway_hz")])
    fit.optimise()
    variances = fit.variances()
    informative = (variances < 0.5 * _DEVIATION**2).sum(axis=0) > 1
    informative[_STARTLE] = informative[_STARTLE].any()
    parameters = {
        name: shrink_estimates(fit.values[:, column], variances[:, column])
        for column, name in enumerate(_NAMES)
        if informative[column]
    }
    rhythms = fit.rhythms()
    means, errors = fit.means(rhythms), fit.squared_errors(rhythms)
    for column, name in enumerate(RHYTHMIC_PARAMETERS):
        parameters[name] = shrink_estimates(means[:, column], errors[:, column])
    return FittedBehaviour(fit.participants, parameters)


class _Fit:
    """Least-squares fit of the movement parameters ``values`` (n, 7) of n participants to their trials.

    ``_pieces``: parts of trials (trial index, rows). A piece is a whole trial. If a participant has only one trial, a
    piece is half this trial. Sampling variances are computed from differences between pieces.
    """

    def __init__(self, motions: Sequence[RecordedMotion]) -> None:
        self.participants = tuple(dict.fromkeys(each.participant for each in motions))
        self._motions = motions
        self._owner = np.array([self.participants.index(each.participant) for each in motions])
        self._measured = [_sampled(each) for each in motions]
        self._pieces: list[tuple[int, slice]] = []
        for number, owner in enumerate(self._owner):
            length = len(self._measured[number])
            single = int((self._owner == owner).sum()) == 1
            bounds = [0, length // 2, length] if single else [0, length]
            self._pieces += [(number, slice(*each)) for each in pairwise(bounds)]
        self._piece_owner = self._owner[[number for number, _ in self._pieces]]
        self._noise_rad = np.full((len(self.participants), len(MOTION_JOINT_NAMES)), INITIAL_NOISE_STD_RAD)
        self._bases = [_nuisance(len(each), None) for each in self._measured]
        self.values = self._best_of_grid()

    def _best_of_grid(self) -> FloatArray:
        grid = np.tile(_MEAN, (len(_GRID), 1))
        for point, chosen in zip(grid, _GRID, strict=True):
            point[[_NAMES.index(name) for name in chosen]] = list(chosen.values())
        points = np.tile(grid[:, None], (1, len(self.participants), 1))
        return grid[self._costs(self._residuals(points), points).argmin(axis=0)]

    def optimise(self) -> None:
        """Reduce the cost of ``values`` by the Levenberg-Marquardt method. Each iteration tries three damping
        factors."""
        everyone, precision = np.arange(len(self.participants)), np.diag(1.0 / _DEVIATION**2)
        damping = np.full(len(everyone), 1e-2)
        factors = np.array([0.01, 1.0, 100.0])
        for iteration in range(ITERATIONS_PER_PASS):
            residuals = self._differentiated()
            if iteration in (0, ITERATIONS_PER_PASS // 2):
                self._measure_noise(residuals)
            normal, slope = (self._per_participant(each) for each in self._normal_equations(residuals))
            slope = slope + (_MEAN - self.values) / _DEVIATION**2
            curvature = normal + precision
            scale = np.einsum("nii->ni", curvature)[:, :, None] * np.eye(len(_NAMES))
            damped = curvature + (factors[:, None] * damping)[..., None, None] * scale
            slopes = np.broadcast_to(slope[..., None], (*damped.shape[:-1], 1))
            steps = np.asarray(np.linalg.solve(damped, slopes), float)[..., 0]
            points = np.clip(self.values + np.concatenate([0.0 * steps[:1], steps]), _LOW, _HIGH)
            costs = self._costs(self._residuals(points), points)
            choice = costs.argmin(axis=0)
            self.values = points[choice, everyone]
            chosen = np.array([100.0, *factors])[choice]
            damping = np.clip(damping * chosen, 1e-6, 1e4)
            if iteration in (0, ITERATIONS_PER_PASS - 1):
                for name, changes in _SEARCHED.items():
                    self._search(_NAMES.index(name), changes)

    def _searched(self, column: int, changes: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns C points (C, n, 7) that differ from ``values`` in one parameter, and their costs (C, pieces)."""
        points = np.tile(self.values, (len(changes), 1, 1))
        points[..., column] = np.clip(points[..., column] + changes[:, None], _LOW[column], _HIGH[column])
        return points, self._piece_costs(self._residuals(points))

    def _search(self, column: int, changes: FloatArray) -> None:
        """Set one parameter to the mean of its best values: those with a cost within ``FIT_COST_TOLERANCE`` of the
        lowest cost."""
        points, of_pieces = self._searched(column, changes)
        costs = self._per_participant(of_pieces.T).T + _prior_costs(points)
        self.values[:, column] = _best(points[..., column], costs)[0]

    def _search_variances(self, column: int, changes: FloatArray) -> FloatArray:
        """Returns the sampling variances (n,) of a parameter.

        A sampling variance is the sum of two variances: between the best values of the pieces (pooled), and between
        values of almost equal cost.
        """
        points, of_pieces = self._searched(column, changes)
        best, variance = _best(points[:, self._piece_owner, column], of_pieces)
        count = np.bincount(self._piece_owner)
        return self.squared_errors(best[:, None])[:, 0] + self._per_participant(variance) / count**2

    def remove_sway(self, sway_hz: FloatArray) -> None:
        """Exclude waist sway with these frequencies (n,) from all residuals computed later."""
        self._bases = [
            _nuisance(len(each), float(sway_hz[owner]))
            for each, owner in zip(self._measured, self._owner, strict=True)
        ]

    def variances(self) -> FloatArray:
        """Returns the sampling variances (n, 7) of ``values``, in squared units of the parameters."""
        precision = np.diag(1.0 / _DEVIATION**2)
        of_pieces, slopes = self._normal_equations(self._differentiated())
        curvature = self._per_participant(of_pieces) + precision
        without = curvature[self._piece_owner] - of_pieces
        change = np.linalg.solve(without, slopes[..., None])[..., 0]
        count = np.bincount(self._piece_owner).astype(float)[:, None]
        jackknife = (count - 1.0) / count * self._per_participant(change**2)
        independent = np.einsum("nii->ni", np.linalg.inv(curvature))
        informative = independent < 0.25 * _DEVIATION**2
        ratio = (jackknife / independent * informative).sum(axis=0) / np.maximum(informative.sum(axis=0), 1)
        variances = independent * np.maximum(ratio, 1.0)
        for name, changes in _SEARCHED.items():
            column = _NAMES.index(name)
            variances[:, column] = self._search_variances(column, changes)
        return np.minimum(variances, _DEVIATION**2)

    def rhythms(self) -> FloatArray:
        """Returns estimates (pieces, 4) of the sway and tremor parameters, in the order of ``RHYTHMIC_PARAMETERS``."""
        residuals = self._residuals(self.values[None], bases=False)
        found: list[list[float]] = []
        for number, rows in self._pieces:
            full = self._motions[number].joint_angles_rad[
                DEFAULT_SUBSTEPS * self._motions[number].first_robot_motion_sample :, HEAD_X_COLUMN
            ]
            tremor = full[_EVERY * rows.start : _EVERY * rows.stop]
            found.append([*_sway(residuals[number][0, rows]), *_tremor(tremor)])
        return np.array(found)

    def means(self, of_pieces: FloatArray) -> FloatArray:
        """Returns the mean (n, ...) over the pieces of each participant."""
        return self._per_participant(of_pieces) / np.bincount(self._piece_owner)[:, None]

    def squared_errors(self, of_pieces: FloatArray) -> FloatArray:
        """Returns the squared standard errors (n, ...) of ``means``. The variance between pieces is pooled over
        participants."""
        count = np.bincount(self._piece_owner)[:, None]
        deviations = of_pieces - self.means(of_pieces)[self._piece_owner]
        return (deviations**2).sum(axis=0) / (count - 1).sum() / count

    def _per_participant(self, of_pieces: FloatArray) -> FloatArray:
        """Returns the sums (n, ...) over the pieces of each participant."""
        sums = np.zeros((len(self.participants), *of_pieces.shape[1:]))
        np.add.at(sums, self._piece_owner, of_pieces)
        return sums

    def _residuals(self, points: FloatArray, *, bases: bool = True) -> list[FloatArray]:
        """Returns the deviations (C, T, 5) of each trial from its predictions, for C parameter points (C, n, 7).

        ``bases``: whether to remove sway and constant offsets of waist and elbow from the deviations.
        """
        predicted = _predictions(self._motions, points[:, self._owner])
        deviations: list[FloatArray] = [
            measured - each for measured, each in zip(self._measured, predicted, strict=True)
        ]
        if bases:
            for deviation, of_channels in zip(deviations, self._bases, strict=True):
                for channel, basis in of_channels.items():
                    deviation[..., channel] -= deviation[..., channel] @ basis @ basis.T
        return deviations

    def _differentiated(self) -> list[FloatArray]:
        """Returns deviations (15, T, 5) in radians of each trial for central differences.

        Row 0: with ``values``. Rows 1 to 7: each parameter increased. Rows 8 to 14: each parameter decreased.
        """
        steps = np.diag(_STEPS)
        points = self.values + np.concatenate([np.zeros((1, len(_NAMES))), steps, -steps])[:, None]
        return self._residuals(np.clip(points, _LOW, _HIGH))

    def _costs(self, residuals: list[FloatArray], points: FloatArray) -> FloatArray:
        """Returns the costs (C, n) of C parameter points: half the robust sum of squares, plus the negative log
        prior."""
        return self._per_participant(self._piece_costs(residuals).T).T + _prior_costs(points)

    def _piece_costs(self, residuals: list[FloatArray]) -> FloatArray:
        """Returns half the robust sums of squares (C, pieces) of the deviations. Outliers have less weight."""
        costs: list[FloatArray] = []
        for (number, rows), owner in zip(self._pieces, self._piece_owner, strict=True):
            scaled = residuals[number][:, rows] / (CAUCHY_WEIGHT_SCALE * self._noise_rad[owner])
            costs.append(0.5 * CAUCHY_WEIGHT_SCALE**2 * np.log1p(scaled**2).sum(axis=(1, 2)))
        return np.stack(costs, axis=1)

    def _normal_equations(self, residuals: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Returns normal matrices (pieces, 7, 7) and gradients (pieces, 7) from ``_differentiated`` deviations."""
        matrices: list[FloatArray] = []
        slopes: list[FloatArray] = []
        for (number, rows), owner in zip(self._pieces, self._piece_owner, strict=True):
            scaled = (residuals[number][:, rows] / self._noise_rad[owner]).reshape(1 + 2 * len(_NAMES), -1)
            up, down = np.split(scaled[1:], 2)
            jacobian = (up - down) / (2.0 * _STEPS[:, None])
            weighted = jacobian / (1.0 + (scaled[0] / CAUCHY_WEIGHT_SCALE) ** 2)
            matrices.append(weighted @ jacobian.T)
            slopes.append(-weighted @ scaled[0])
        return np.array(matrices), np.array(slopes)

    def _measure_noise(self, residuals: list[FloatArray]) -> None:
        for owner in range(len(self.participants)):
            own = np.concatenate(
                [each[0] for each, of in zip(residuals, self._owner, strict=True) if of == owner]
            )
            self._noise_rad[owner] = np.maximum(
                MAD_TO_SD_FACTOR * np.median(np.abs(own), axis=0), MIN_NOISE_STD_RAD
            )


def _prior_costs(points: FloatArray) -> FloatArray:
    """Returns the negative log prior (C, n) of parameter points (C, n, 7)."""
    return 0.5 * (((points - _MEAN) / _DEVIATION) ** 2).sum(axis=-1)


def _best(values: FloatArray, costs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Returns mean and variance (n,) of the best of C values (C, n).

    The best values have costs (C, n) within ``FIT_COST_TOLERANCE`` of the lowest cost.
    """
    best = costs < costs.min(axis=0) + FIT_COST_TOLERANCE
    count = best.sum(axis=0)
    mean = (best * values).sum(axis=0) / count
    return mean, (best * (values - mean) ** 2).sum(axis=0) / count


# Models


@dataclass(frozen=True)
class _Perceived:
    """Observations of N people, see ``people.cooperation.PersonObservation``."""

    tool_pos_w: FloatArray
    head_pos_w: FloatArray
    mouth_pos_w: FloatArray
    right_arm_pos_w: FloatArray


def _sampled(motion: RecordedMotion) -> FloatArray:
    """Returns the recorded angles (T, 5) in radians during the robot's motion, 20 a second."""
    angles = np.concatenate(
        [motion.joint_angles_rad, np.tile(motion.joint_angles_rad[-1], (MOTION_LAG_TICKS, 1))]
    )
    return angles[DEFAULT_SUBSTEPS * motion.first_robot_motion_sample + MOTION_LAG_TICKS :: _EVERY][
        : 2 * (len(motion.tool_pos_w) - motion.first_robot_motion_sample)
    ]


def _predictions(motions: Sequence[RecordedMotion], points: FloatArray) -> list[FloatArray]:
    """Returns the predicted angles (C, T, 5) in radians of each trial, for C parameter points (C, trials, 7).

    The predictions contain no rhythmic motion and no noise.
    """
    predicted: list[FloatArray] = [np.empty(0)] * len(motions)
    kinds = dict.fromkeys((each.offered_body_part, each.posture) for each in motions)
    for kind in kinds:
        numbers = [n for n, each in enumerate(motions) if (each.offered_body_part, each.posture) == kind]
        chosen = [motions[number] for number in numbers]
        angles = _predict(chosen, points[:, numbers])
        for number, each in zip(numbers, np.moveaxis(angles, 2, 0), strict=True):
            begin, end = 2 * motions[number].first_robot_motion_sample, 2 * len(motions[number].tool_pos_w)
            predicted[number] = each[:, begin:end]
    return predicted


def _predict(motions: Sequence[RecordedMotion], points: FloatArray) -> FloatArray:
    """Returns predicted angles (C, T, trials, 5) in radians, from the start of the trials.

    All trials have the same offered part and the same posture.
    """
    candidates, trials = points.shape[:2]
    longest = max(len(each.tool_pos_w) for each in motions)

    def stacked(name: str) -> FloatArray:
        arrays = [getattr(each, name) for each in motions]
        ends = [np.concatenate([each, np.repeat(each[-1:], longest - len(each), axis=0)]) for each in arrays]
        return np.tile(np.stack(ends, axis=1), (1, candidates, *[1] * (arrays[0].ndim - 1)))

    perceived = [stacked(name) for name in ("tool_pos_w", "head_pos_w", "mouth_pos_w", "right_arm_pos_w")]
    persons = [each.person for each in motions] * candidates
    people = People.from_persons(persons)
    values = points.reshape(-1, len(_NAMES))
    parameters = make_behaviour_parameters([dict(zip(_NAMES, row, strict=True)) for row in values.tolist()])
    rows = len(values)
    state = partner_behaviour.make_initial_state(people, parameters, np.full((rows, 4), 0.5))
    moved = motor_model.make_initial_state(people, None, parameters.speed_share, np.zeros((rows, 3)))
    usual_follow, moved = moved.filter_gain, _only(moved, _MOVING)
    shown: list[FloatArray] = []
    targets_rad = state.initial_angles_rad.copy()
    for now in zip(*perceived, strict=True):
        targets_rad[:, _MOVING] = moved.second_filter_angles_rad
        state, goals = partner_behaviour.choose_goal_angles(
            replace(state, joint_targets_rad=targets_rad),
            _Perceived(*now),
            motions[0].offered_body_part,
            motions[0].posture,
        )
        startled = partner_behaviour.are_startled(state)
        pace = np.where(startled, STARTLE_SPEED_FACTOR, moved.speed_factor)
        follow = np.where(startled[:, None], STARTLE_FILTER_GAIN, usual_follow)
        moved = replace(
            moved,
            goal_angles_rad=np.clip(goals, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD)[:, _MOVING],
            max_step_rad=(PHYSICS_STEP_S * NOISE_FREE_SPEED_FRACTION * pace)[:, None]
            * MAX_JOINT_SPEED_RAD_S[_MOVING],
            filter_gain=follow[:, _MOVING],
        )
        for tick in range(DEFAULT_SUBSTEPS):
            if tick % _EVERY == 0:
                shown.append(moved.second_filter_angles_rad[:, _SHOWN])
            moved = motor_model.advance_motor_state(moved)
    angles = np.stack(shown).reshape(len(shown), candidates, trials, len(MOTION_JOINT_NAMES))
    return angles.transpose(1, 0, 2, 3)


def _only(state: motor_model.MotorState, joints: list[int]) -> motor_model.MotorState:
    """Returns the motor state of the selected joints, without rhythmic motion."""
    names = (
        "goal_angles_rad", "equilibrium_angles_rad", "first_filter_angles_rad", "second_filter_angles_rad",
        "max_step_rad", "filter_gain",
    )  # fmt: skip
    return replace(state, **{name: getattr(state, name)[:, joints] for name in names})


def _nuisance(count: int, sway_hz: float | None) -> dict[int, FloatArray]:
    """Returns an orthonormal basis (T, K) of the ignored motion (offset and sway), by index of the angle."""
    times_s = _EVERY * PHYSICS_STEP_S * np.arange(count)

    def basis(frequency_hz: float | None) -> FloatArray:
        if frequency_hz is None:
            return np.full((count, 1), count**-0.5)
        return np.linalg.qr(_sinusoid(times_s, frequency_hz))[0]

    sideways_hz = None if sway_hz is None else SIDEWAYS_SWAY_FREQUENCY_RATIO * sway_hz
    return {WAIST_X_COLUMN: basis(sway_hz), WAIST_Y_COLUMN: basis(sideways_hz), ELBOW_COLUMN: basis(None)}


def _sinusoid(times_s: FloatArray, frequency_hz: float) -> FloatArray:
    """Returns a constant, a cosine and a sine as columns (T, 3), at the times ``times_s`` (T,)."""
    angle = 2.0 * np.pi * frequency_hz * times_s
    return np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], axis=1)


def _sway(deviations_rad: FloatArray) -> tuple[float, float]:
    """Returns amplitude (degrees) and frequency (Hz) of the sway, from deviations (T, 5) in radians.

    The sway is the sinusoid with the smallest squared error to the waist deviations.
    """
    times_s = _EVERY * PHYSICS_STEP_S * np.arange(len(deviations_rad))
    best = np.inf, 0.0, 0.0
    low_hz, high_hz = SWAY_BAND_HZ
    for frequency_hz in np.arange(max(low_hz, 1.0 / times_s[-1]), high_hz, SWAY_FREQUENCY_STEP_HZ):
        error, power = 0.0, 0.0
        for channel, factor in ((WAIST_X_COLUMN, 1.0), (WAIST_Y_COLUMN, SIDEWAYS_SWAY_FREQUENCY_RATIO)):
            basis = _sinusoid(times_s, factor * frequency_hz)
            found = np.linalg.lstsq(basis, deviations_rad[:, channel], rcond=None)[0]
            error += float(((deviations_rad[:, channel] - basis @ found) ** 2).sum())
            power += 0.5 * float(found[1] ** 2 + found[2] ** 2)
        best = min(best, (error, float(np.degrees(np.sqrt(power))), float(frequency_hz)))
    return best[1:]


def _tremor(head_x_rad: FloatArray) -> tuple[float, float]:
    """Returns amplitude (degrees) and frequency (Hz) of the strongest tremor in head angles (T,), 100 a second.

    The spectrum is estimated by Welch's method. The angles are constant between tracking frames; the amplitude is
    corrected for this.
    """
    window = min(2 * round(1.0 / PHYSICS_STEP_S), len(head_x_rad))
    frequency_hz, power = signal.welch(
        head_x_rad, 1.0 / PHYSICS_STEP_S, nperseg=window, nfft=8192, scaling="spectrum"
    )
    (band,) = np.nonzero((frequency_hz >= TREMOR_BAND_HZ[0]) & (frequency_hz <= TREMOR_BAND_HZ[1]))
    peak = band[power[band].argmax()]
    excess = max(float(power[peak] - np.median(power[band])), 0.0)
    changes = np.flatnonzero(np.diff(head_x_rad))
    held_s = PHYSICS_STEP_S * float(np.median(np.diff(changes))) if len(changes) > 1 else PHYSICS_STEP_S
    passed = np.sinc(frequency_hz[peak] * held_s)
    return float(np.degrees(np.sqrt(2.0 * excess)) / passed), float(frequency_hz[peak])
