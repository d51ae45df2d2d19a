"""Fit the regression model of one dependent variable, and estimate each effect."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from avrgym.analysis.models.effects import (
    POLICY_EFFECT,
    ROBOT_EFFECT,
    DesignMatrix,
    Effect,
    TrialValue,
    make_design_matrix,
)
from avrgym.analysis.models.estimate import EffectEstimate, FittedModel, ModelFitError
from avrgym.analysis.models.mixed_models import fit_mixed_model
from avrgym.analysis.models.ordinal_models import fit_ordinal_model
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS
from avrgym.array_types import FloatArray
from avrgym.study.design.design import Design

ORDINAL_MODEL, LOGISTIC_MODEL, MIXED_MODEL = "ordinal", "logistic", "mixed"
EstimateByEffect = Mapping[Effect, EffectEstimate | ModelFitError]
RANDOM_EFFECT_BY_KIND = {POLICY_EFFECT: "policy", ROBOT_EFFECT: "robot"}
"""Name of the random effect by kind of effect. The effects of policies and robots can differ between participants."""
UNRELIABLE_P_NOTE = "p is unreliable: no variance of this effect between participants was found"


def drop_constant_groups(model: str, observed: Sequence[TrialValue]) -> tuple[list[TrialValue], str]:
    """Drop each task and robot with only minimum values, or only maximum values, of the scale (complete separation).

    The effect of a dropped group would be unbounded. The group contains no information about other effects. For mixed
    models, no group is dropped.

    Returns:
        The remaining values, and a note with the dropped groups. The note is empty if no group was dropped.
    """
    kept, left_out = list(observed), list[str]()
    if model == MIXED_MODEL or len({each.value for each in observed}) < 2:
        return kept, ""
    for of in (_task, _robot):
        given = [each.value for each in kept]
        ends = {min(given), max(given)} if given else set[float]()
        for group in dict.fromkeys(map(of, kept)):
            values = {each.value for each in kept if of(each) == group}
            if len(values) == 1 and values <= ends:
                kept = [each for each in kept if of(each) != group]
                left_out.append(group)
    words = (
        f"left out, because all their values are at the same end of the scale: {', '.join(left_out)}"
        if left_out
        else ""
    )
    return kept, words


def _task(observed: TrialValue) -> str:
    return observed.task


def _robot(observed: TrialValue) -> str:
    return observed.robot


def estimate_effects(
    design: Design, model: str, observed: Sequence[TrialValue], requested_effects: Sequence[Effect]
) -> EstimateByEffect:
    """Fit the model. Returns the estimate of each effect, or a ``ModelFitError`` if the effect cannot be estimated."""
    if len({each.value for each in observed}) < 2:
        return dict.fromkeys(
            requested_effects, ModelFitError("all values are equal" if observed else "there are no values")
        )
    observed, _ = drop_constant_groups(model, observed)
    if not observed:
        return dict.fromkeys(
            requested_effects,
            ModelFitError("each task, or each robot, has all its values at one end of the scale"),
        )
    try:
        names = make_design_matrix(design, observed)
        fitted = fit_model(model, observed, names)
    except ModelFitError as error:
        return dict.fromkeys(requested_effects, error)
    return {effect: _estimate(fitted, names, effect) for effect in requested_effects}


def _estimate(fitted: FittedModel, names: DesignMatrix, effect: Effect) -> EffectEstimate | ModelFitError:
    try:
        found = fitted.estimate(names.make_contrast(effect))
    except ModelFitError as error:
        return error
    own = f"participant by {RANDOM_EFFECT_BY_KIND.get(effect.kind)}"
    return replace(found, note=f"{found.note}; {UNRELIABLE_P_NOTE}") if own in found.note else found


def fit_model(model: str, observed: Sequence[TrialValue], names: DesignMatrix) -> FittedModel:
    """Returns a fitted model with participants as clusters. Raises ``ModelFitError`` if it cannot be estimated."""
    participants = [each.participant for each in observed]
    if len(set(participants)) < MIN_PARTICIPANTS:
        raise ModelFitError(f"fewer than {MIN_PARTICIPANTS} participants")
    values = [each.value for each in observed]
    if model != MIXED_MODEL:
        return fit_ordinal_model(values, names.matrix, participants)
    design = np.hstack([np.ones((len(values), 1)), names.matrix])
    together = make_random_effect_labels(observed)
    fitted = fit_mixed_model(values, design, participants, list(together.values()))
    return _WithConstant(fitted, _singular([list(together)[place] for place in fitted.zero_variance_indices]))


def _singular(zero_variances: Sequence[str]) -> str:
    """Returns a warning with the names of random effects with zero variance; empty if no variance is zero."""
    return f"singular: random effect at zero: {', '.join(zero_variances)}" if zero_variances else ""


class _WithConstant:
    """Adds an intercept to a fitted model: contrasts contain no weight for it. All estimates contain ``note``."""

    def __init__(self, fitted: FittedModel, note: str) -> None:
        self._fitted, self._note = fitted, note

    def estimate(self, contrast: FloatArray) -> EffectEstimate:
        return replace(self._fitted.estimate(np.concatenate([[0.0], contrast])), note=self._note)


def make_random_effect_labels(observed: Sequence[TrialValue]) -> dict[str, list[str]]:
    """Returns the labels (n,) by random effect: participant, and participant by policy, by robot and by task.

    A random effect is omitted if its labels are equal to the participants, or if all labels differ.
    """
    whole = [each.participant for each in observed]
    finer = {
        f"participant by {name}": [f"{each.participant} {getattr(each, name)}" for each in observed]
        for name in ("policy", "robot", "task")
    }
    people = len(set(whole))
    found = {"participant": whole} if people < len(whole) else {}
    return found | {name: each for name, each in finer.items() if people < len(set(each)) < len(whole)}
