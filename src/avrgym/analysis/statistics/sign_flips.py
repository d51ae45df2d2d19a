"""Sign-flip permutation test. It controls the family-wise error rate of paired tests with the same participants.

Null hypothesis: the joint distribution of the differences of a participant does not change if all signs are flipped.
The statistics of all tests are computed for each combination of flips. For each combination, the maximum statistic over
all tests is determined. The p value of a test is the share of maxima that reach its observed statistic (max-T: Westfall
and Young, Resampling-Based Multiple Testing, 1993). Tests are corrected step-down, from the largest to the smallest
observed statistic (Romano and Wolf, J. Am. Stat. Assoc. 100, 2005). The correction accounts for dependence between
tests. It is therefore more powerful than Holm's correction.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np
from scipy import stats

from avrgym.array_types import FloatArray
from avrgym.system import random_streams

MAX_EXACT_PARTICIPANTS = 14
"""Maximum number of participants for the exact test, which uses all combinations of signs."""
RANDOM_FLIP_COUNT = 9_999
"""Number of random sign combinations for more participants. The observed combination is added."""
STATISTIC_TOLERANCE = 1e-9


def compute_sign_flip_p_values(differences: Sequence[Mapping[str, float]]) -> list[float | None]:
    """Returns the corrected p value of each signed-rank test; ``None`` if all differences of a test are zero.

    Args:
        differences: for each test, the differences by participant. Participants without a value are omitted.
    """
    ranks = compute_signed_ranks(differences)
    sizes = np.sqrt((ranks**2).sum(axis=0))
    tested = np.flatnonzero(sizes)
    found: list[float | None] = [None] * len(differences)
    if not len(tested):
        return found
    flipped = np.abs(make_sign_flips(len(ranks)) @ (ranks[:, tested] / sizes[tested]))
    for test, p in zip(tested, compute_step_down_p_values(flipped), strict=True):
        found[int(test)] = float(p)
    return found


def compute_signed_ranks(differences: Sequence[Mapping[str, float]]) -> FloatArray:
    """Returns signed ranks (participants, tests). The rank of a zero or missing difference is zero."""
    people = sorted({person for own in differences for person in own})
    found = np.zeros((len(people), len(differences)))
    for test, own in enumerate(differences):
        given = np.array([own.get(person, 0.0) for person in people])
        used = given != 0.0
        found[used, test] = stats.rankdata(np.abs(given[used])) * np.sign(given[used])
    return found


@cache
def make_sign_flips(participants: int) -> FloatArray:
    """Returns signs ±1 (combinations, participants). The first row contains the observed signs.

    The exact test uses one of two opposite combinations, because opposite signs give the same absolute statistics.
    """
    if participants > MAX_EXACT_PARTICIPANTS:
        drawn = random_streams.make_sign_flip_rng().integers(0, 2, (RANDOM_FLIP_COUNT, participants))
        return np.vstack([np.ones(participants), 1.0 - 2.0 * drawn])
    free = max(participants - 1, 0)
    chosen = np.array(list(product([1.0, -1.0], repeat=free))).reshape(2**free, free)
    return np.hstack([np.ones((2**free, participants - free)), chosen])


def compute_step_down_p_values(statistics: FloatArray) -> FloatArray:
    """Returns corrected p values (tests,) from ``statistics`` (combinations, tests). Row 0: observed statistics."""
    observed = statistics[0]
    order = np.argsort(-observed, kind="stable")
    found = np.zeros(len(order))
    largest = 0.0
    for place, test in enumerate(order):
        others = statistics[:, order[place:]].max(axis=1)
        largest = max(largest, float((others >= observed[test] - STATISTIC_TOLERANCE).mean()))
        found[test] = largest
    return found
