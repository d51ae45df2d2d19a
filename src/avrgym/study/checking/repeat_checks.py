"""Check the repeats that experimenters requested: their number, and their dependence on policy and outcome.

The tests are exact. Under the null hypothesis, each trial of a participant and task is equally likely to be repeated.
All tests together then report a finding in at most 1 % of studies.
"""

from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from math import comb

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.study.checking.finding import Finding
from avrgym.study.checking.repeats import AttemptedTrial, list_attempted_trials
from avrgym.study.design.design import Design
from avrgym.study.storage.store import StudyStore

BlockCounts = tuple[int, int, int]
"""Numbers of units (for example trials) in a block: all units, units in the group, and selected units."""


def compute_selection_p_value(blocks: Iterable[BlockCounts], selected_in_group: int) -> float:
    """Returns the exact two-sided p-value of ``selected_in_group``, the number of selected units in a group.

    Under the null hypothesis, all units of a block are equally likely to be selected. The number is then a sum of
    hypergeometric variables, one for each block. p is the total probability of all equally likely or less likely sums.
    """
    probabilities: FloatArray = np.ones(1)
    for block in blocks:
        probabilities = np.convolve(probabilities, _hypergeometric(*block))
    observed = probabilities[selected_in_group] * (1.0 + 1e-9)
    return min(1.0, float(probabilities[probabilities <= observed].sum()))


def _hypergeometric(units: int, members: int, drawn: int) -> list[float]:
    """Returns the probability that 0, 1, …, ``drawn`` of the selected units are in the group (hypergeometric).

    ``units``: number of units. ``members``: number of units in the group. ``drawn``: number of selected units.
    """
    return [
        comb(members, hits) * comb(units - members, drawn - hits) / comb(units, drawn)
        for hits in range(drawn + 1)
    ]


REPEATS_LOCATION = "repeats"
"""The value of ``Finding.where`` for repeats."""
POLICY_ALPHA, CONDITION_ALPHA, OUTCOME_ALPHA = 0.005, 0.0025, 0.0025
"""Significance levels of the tests for policy, condition (robot and policy) and outcome."""


def check_repeats(store: StudyStore, limit: int | None = None) -> Iterator[Finding]:
    """Yields findings about repeats of people's trials, or of simulated participants' trials in a study without people.

    ``limit`` replaces the design's ``max_repeats``.
    """
    limit = store.design.max_repeats if limit is None else limit
    yield from check_trial_repeats(list_trials_in_repeat_tests(store), store.design, limit)


def check_trial_repeats(
    trials: Sequence[AttemptedTrial], design: Design, limit: int | None
) -> Iterator[Finding]:
    """Yields findings about the repeats of these trials. ``limit``: maximum number of repeats of a trial."""
    if limit is not None:
        yield from _too_many(trials, limit)
    yield from _by_condition(trials, design)
    yield from _by_outcome(trials, design.trial_steps)


def list_trials_in_repeat_tests(store: StudyStore) -> list[AttemptedTrial]:
    """Returns the trials of people. In a study without people, returns the trials of simulated participants."""
    simulated = is_simulated_study(store)
    return [each for each in list_attempted_trials(store) if each.participant.simulated is simulated]


def is_simulated_study(store: StudyStore) -> bool:
    """Returns whether a study has no real participants."""
    return all(each.simulated for each in [*store.read_participants(), *store.read_deleted_participants()])


def _too_many(trials: Sequence[AttemptedTrial], limit: int) -> Iterator[Finding]:
    over = [each for each in trials if each.requested_repeat_count > limit]
    if not over:
        return
    listed = ", ".join(
        f"{each.participant} trial {each.trial.position} ({each.requested_repeat_count})" for each in over
    )
    people = Counter(
        repeat.requested_by for each in over for repeat in each.replaced_attempts if repeat.is_requested
    )
    by = ", ".join(f"{person} ({number})" for person, number in people.items())
    yield _finding(
        f"{_trials(len(over))} repeated more often than max_repeats = {limit} allows: {listed}; requested by {by}"
    )


def _by_condition(trials: Sequence[AttemptedTrial], design: Design) -> Iterator[Finding]:
    """Yields findings about policies with significantly more or fewer repeats than the other policies.

    If there are none, pairs of robot and policy are compared.
    """

    def policy(each: AttemptedTrial) -> str:
        return design.choose_displayed_policy(each.trial.policy, practice=False)

    found = list(_unequal("policy", trials, policy, POLICY_ALPHA))
    if len(design.robots) > 1 and not found:
        found = list(
            _unequal("condition", trials, lambda each: f"{each.trial.robot} {policy(each)}", CONDITION_ALPHA)
        )
    yield from found


def _unequal(
    quantity: str, trials: Sequence[AttemptedTrial], group_of: Callable[[AttemptedTrial], str], alpha: float
) -> Iterator[Finding]:
    groups = sorted({group_of(each) for each in trials})
    tests = 1 if len(groups) == 2 else len(groups)
    p = [min(1.0, tests * _p(trials, _in(group_of, group), _is_repeated)) for group in groups]
    if min(p, default=1.0) > alpha:
        return
    counts = "; ".join(
        _count(group, [each for each in trials if group_of(each) == group]) for group in groups
    )
    yield _finding(
        f"requested by experimenters depend on the {quantity}: {counts} (exact test, p = {min(p):.1g})"
    )


def _count(group: str, own: Sequence[AttemptedTrial]) -> str:
    extra, repeated = sum(each.requested_repeat_count for each in own), sum(map(_is_repeated, own))
    succeeded = sum(
        bool(repeat.success) for each in own for repeat in each.replaced_attempts if repeat.is_requested
    )
    outcomes = f" ({succeeded} of the replaced attempts had succeeded)" if extra else ""
    return f"{group} {extra} extra attempts in {repeated} of {len(own)} trials{outcomes}"


def _by_outcome(trials: Sequence[AttemptedTrial], steps: int) -> Iterator[Finding]:
    """Yields a finding if repeats of finished first attempts depend significantly on success."""
    finished = [each for each in trials if (each.attempts[0].metrics.steps or 0) >= steps]
    p = _p(finished, _failed, _is_first_repeated)
    if p > OUTCOME_ALPHA:
        return
    failed = [each for each in finished if _failed(each)]
    others = [each for each in finished if not _failed(each)]
    yield _finding(
        "requested by experimenters depend on the outcome: of finished first attempts "
        f"{sum(map(_is_first_repeated, failed))} of {len(failed)} without success were repeated, "
        f"{sum(map(_is_first_repeated, others))} of {len(others)} with success (exact test, p = {p:.1g})"
    )


def _p(
    trials: Sequence[AttemptedTrial],
    in_group: Callable[[AttemptedTrial], bool],
    drawn: Callable[[AttemptedTrial], bool],
) -> float:
    """Returns the p-value of an exact test, stratified by participant and task.

    Null hypothesis: trials in the group are selected (``drawn``) as often as other trials.
    """
    blocks: Mapping[Hashable, list[AttemptedTrial]] = defaultdict(list)
    for each in trials:
        blocks[each.participant.number, each.trial.task].append(each)
    sizes = [(len(own), sum(map(in_group, own)), sum(map(drawn, own))) for own in blocks.values()]
    return compute_selection_p_value(sizes, sum(in_group(each) and drawn(each) for each in trials))


def _in(group_of: Callable[[AttemptedTrial], str], group: str) -> Callable[[AttemptedTrial], bool]:
    return lambda each: group_of(each) == group


def _is_repeated(each: AttemptedTrial) -> bool:
    return each.requested_repeat_count > 0


def _failed(each: AttemptedTrial) -> bool:
    return not each.attempts[0].metrics.success


def _is_first_repeated(each: AttemptedTrial) -> bool:
    return bool(each.replaced_attempts) and each.replaced_attempts[0].is_requested


def _trials(number: int) -> str:
    return "1 trial was" if number == 1 else f"{number} trials were"


def _finding(message: str) -> Finding:
    return Finding(REPEATS_LOCATION, message, is_error=False)
