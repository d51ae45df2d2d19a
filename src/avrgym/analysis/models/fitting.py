"""Fitting the model that suits a quantity to its values, and reading every effect from it."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from avrgym.analysis.models.effects import POLICIES, ROBOTS, DesignMatrix, Effect, TrialValue, design_matrix
from avrgym.analysis.models.estimate import Estimate, FitError, Fitted
from avrgym.analysis.models.mixed import fit_mixed
from avrgym.analysis.models.ordinal import fit_ordinal
from avrgym.analysis.statistics.comparisons import MIN_PARTICIPANTS
from avrgym.array_types import FloatArray
from avrgym.study.design.design import Design

ORDINAL, LOGISTIC, MIXED = "ordinal", "logistic", "mixed"
EffectEstimates = Mapping[Effect, Estimate | FitError]
RANDOM_EFFECT_OF = {POLICIES: "policy", ROBOTS: "robot"}
"""By kind of effect, the condition to which participants respond differently."""
UNRELIABLE = "p is unreliable: no variance of this effect between participants was found"


def drop_constant_groups(model: str, observed: Sequence[TrialValue]) -> tuple[list[TrialValue], str]:
    """The values that tell how others differ within a task and with a robot, and in words which do not.

    Where all answers to a task are at the same end of the scale, its own effect has no bound, and nothing else follows
    from it: the others are estimated as if it were not there.
    """
    kept, left_out = list(observed), list[str]()
    if model == MIXED or len({each.value for each in observed}) < 2:
        return kept, ""
    for of in (_task, _robot):
        given = [each.value for each in kept]
        ends = {min(given), max(given)} if given else set[float]()
        for group in dict.fromkeys(map(of, kept)):
            values = {each.value for each in kept if of(each) == group}
            if len(values) == 1 and values <= ends:
                kept = [each for each in kept if of(each) != group]
                left_out.append(group)
    words = f"left out, as all their values are at the same end: {', '.join(left_out)}" if left_out else ""
    return kept, words


def _task(observed: TrialValue) -> str:
    return observed.task


def _robot(observed: TrialValue) -> str:
    return observed.robot


def estimate_effects(
    design: Design, model: str, observed: Sequence[TrialValue], wanted: Sequence[Effect]
) -> EffectEstimates:
    """Each effect in a model of these values, or why there is none."""
    if len({each.value for each in observed}) < 2:
        return dict.fromkeys(wanted, FitError("all values are equal" if observed else "there are no values"))
    observed, _ = drop_constant_groups(model, observed)
    if not observed:
        return dict.fromkeys(wanted, FitError("each task, or each robot, has all its values at one end"))
    try:
        names = design_matrix(design, observed)
        fitted = fit_model(model, observed, names)
    except FitError as error:
        return dict.fromkeys(wanted, error)
    return {effect: _estimate(fitted, names, effect) for effect in wanted}


def _estimate(fitted: Fitted, names: DesignMatrix, effect: Effect) -> Estimate | FitError:
    try:
        found = fitted.estimate(names.contrast(effect))
    except FitError as error:
        return error
    own = f"participant by {RANDOM_EFFECT_OF.get(effect.kind)}"
    return replace(found, note=f"{found.note}; {UNRELIABLE}") if own in found.note else found


def fit_model(model: str, observed: Sequence[TrialValue], names: DesignMatrix) -> Fitted:
    """Fit a model to values, each participant a cluster; raises ``FitError`` where they do not determine it."""
    participants = [each.participant for each in observed]
    if len(set(participants)) < MIN_PARTICIPANTS:
        raise FitError(f"fewer than {MIN_PARTICIPANTS} participants")
    values = [each.value for each in observed]
    if model != MIXED:
        return fit_ordinal(values, names.matrix, participants)
    design = np.hstack([np.ones((len(values), 1)), names.matrix])
    together = random_effects(observed)
    fitted = fit_mixed(values, design, participants, list(together.values()))
    return _WithConstant(fitted, _singular([list(together)[place] for place in fitted.at_zero]))


def _singular(at_zero: Sequence[str]) -> str:
    """What a reader must know of random effects at zero; nothing where there are none."""
    return f"singular: random effect at zero: {', '.join(at_zero)}" if at_zero else ""


class _WithConstant:
    """A model whose first coefficient is a constant, which no effect is about; ``note`` goes with each estimate."""

    def __init__(self, fitted: Fitted, note: str) -> None:
        self._fitted, self._note = fitted, note

    def estimate(self, contrast: FloatArray) -> Estimate:
        return replace(self._fitted.estimate(np.concatenate([[0.0], contrast])), note=self._note)


def random_effects(observed: Sequence[TrialValue]) -> dict[str, list[str]]:
    """How values of a participant are alike: all of them, those with a policy, with a robot, and of a task.

    Left out is what all of a participant's values have in common, but for the first, and what no two have.
    """
    whole = [each.participant for each in observed]
    finer = {
        f"participant by {name}": [f"{each.participant} {getattr(each, name)}" for each in observed]
        for name in ("policy", "robot", "task")
    }
    people = len(set(whole))
    found = {"participant": whole} if people < len(whole) else {}
    return found | {name: each for name, each in finer.items() if people < len(set(each)) < len(whole)}
