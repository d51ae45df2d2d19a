"""Family-wise correction of paired tests with the same participants, without the loss of power of Holm's bounds.

If groups do not differ, the opposite signs of all differences of a participant together are equally likely. The signs
of participants are flipped in every combination. Each test is compared with the largest statistic of all tests in the
same flip (Westfall and Young, Resampling-Based Multiple Testing, 1993). This goes step by step from the largest to the
smallest statistic (Romano and Wolf, J. Am. Stat. Assoc. 100, 2005). The dependence of the tests is thus kept.
"""

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product

import numpy as np
from scipy import stats

from avrgym.array_types import FloatArray
from avrgym.system import random_streams

MAX_ENUMERATED = 14
"""Up to so many participants every choice of signs is computed."""
SAMPLED_FLIPS = 9_999
"""For more participants so many choices are drawn, in addition to the one observed."""
TOLERANCE = 1e-9


def sign_flip_p_values(differences: Sequence[Mapping[str, float]]) -> list[float | None]:
    """p of each signed-rank test after correction for all of them; ``None`` where all differences are zero.

    Args:
        differences: for each test the differences by participant; participants without a value are absent.
    """
    ranks = signed_ranks(differences)
    sizes = np.sqrt((ranks**2).sum(axis=0))
    tested = np.flatnonzero(sizes)
    found: list[float | None] = [None] * len(differences)
    if not len(tested):
        return found
    flipped = np.abs(sign_flips(len(ranks)) @ (ranks[:, tested] / sizes[tested]))
    for test, p in zip(tested, step_down(flipped), strict=True):
        found[int(test)] = float(p)
    return found


def signed_ranks(differences: Sequence[Mapping[str, float]]) -> FloatArray:
    """The signed ranks (participants, tests); zero for a difference of zero, and for none."""
    people = sorted({person for own in differences for person in own})
    found = np.zeros((len(people), len(differences)))
    for test, own in enumerate(differences):
        given = np.array([own.get(person, 0.0) for person in people])
        used = given != 0.0
        found[used, test] = stats.rankdata(np.abs(given[used])) * np.sign(given[used])
    return found


@cache
def sign_flips(participants: int) -> FloatArray:
    """Choices of signs (choices, participants), the one observed first; opposite choices count once."""
    if participants > MAX_ENUMERATED:
        drawn = random_streams.sampled_sign_flips().integers(0, 2, (SAMPLED_FLIPS, participants))
        return np.vstack([np.ones(participants), 1.0 - 2.0 * drawn])
    free = max(participants - 1, 0)
    chosen = np.array(list(product([1.0, -1.0], repeat=free))).reshape(2**free, free)
    return np.hstack([np.ones((2**free, participants - free)), chosen])


def step_down(statistics: FloatArray) -> FloatArray:
    """p (tests,) from the statistics (choices, tests) of which the first row was observed."""
    observed = statistics[0]
    order = np.argsort(-observed, kind="stable")
    found = np.zeros(len(order))
    largest = 0.0
    for place, test in enumerate(order):
        others = statistics[:, order[place:]].max(axis=1)
        largest = max(largest, float((others >= observed[test] - TOLERANCE).mean()))
        found[test] = largest
    return found
