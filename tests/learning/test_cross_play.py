"""Cross-play: each policy meets the same people, and each cell equals a separate evaluation."""

import pytest

from avrgym.learning.cross_play import make_success_table, run_cross_play
from avrgym.learning.evaluation import evaluate_all
from helpers.vr.visit import ENVIRONMENT

POLICIES, PEOPLE = ["zero", "random"], ["original", "zoo/unseen/startled"]


@pytest.mark.slow
def test_cross_play_equals_single_evaluations() -> None:
    steps: list[int] = []
    rows = run_cross_play([ENVIRONMENT], POLICIES, PEOPLE, 1, 5, steps.append, impairment="weakness", jobs=1)
    assert [(row.people, row.policy) for row in rows] == [
        (people, policy) for people in PEOPLE for policy in POLICIES
    ]
    (alone,) = evaluate_all([ENVIRONMENT], "random", PEOPLE[1], 1, 5, impairment="weakness", jobs=1)
    assert rows[3] == alone
    assert {row.impairment for row in rows} == {"weakness"}
    assert sum(steps) == 4 * 200
    table = make_success_table(rows)
    assert [[*line] for line in table] == [["env", "policy", *PEOPLE]] * 2
    assert table[0] == {"env": ENVIRONMENT, "policy": "zero"} | dict.fromkeys(PEOPLE, "0% [0, 79]")


@pytest.mark.parametrize(
    ("policies", "people", "impairment", "said"),
    [
        (["nope"], PEOPLE, "none", "no policy 'nope'"),
        (POLICIES, ["original", "zoo/nope"], "none", "unknown population 'zoo/nope'"),
        (POLICIES, PEOPLE, "gout", "allowed: none, limits"),
    ],
)
def test_unknown_names_are_refused_before_the_evaluation(policies, people, impairment, said) -> None:
    steps: list[int] = []
    with pytest.raises(ValueError, match=said):
        run_cross_play([ENVIRONMENT], policies, people, 1, 0, steps.append, impairment=impairment)
    assert steps == []
