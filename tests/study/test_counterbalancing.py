"""Orders, allocation and planned trials are balanced for all sizes of a design."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise

import msgspec
import numpy as np
import pytest

from avrgym.study.design.allocation import (
    PlannedTrial,
    choose_practice_robots,
    find_least_used_order_index,
    list_order_indices_for_site,
    make_trial_orders,
    plan_trials,
)
from avrgym.study.design.counterbalancing import TaskBlock, make_balanced_orders, make_williams_square
from avrgym.study.design.design import Design, parse_design, read_default_design_text
from avrgym.tasks.constants import PAPER_ENVIRONMENTS
from avrgym.tasks.registry import ENVIRONMENTS

SIZES = range(2, 9)
PAPER = parse_design(read_default_design_text())


def assert_balanced(rows: Sequence[Sequence[int]], size: int) -> None:
    """Assert equal counts at each position and after each other condition."""
    positions = Counter((place, name) for row in rows for place, name in enumerate(row))
    successions = Counter(pair for row in rows for pair in pairwise(row))
    assert len(positions) == size**2
    assert len(successions) == size * (size - 1)
    assert len(set(positions.values())) == 1
    assert len(set(successions.values())) == 1


@pytest.mark.parametrize("size", SIZES)
def test_williams_square_is_balanced(size):
    square = make_williams_square(size)
    assert square.shape == (size if size % 2 == 0 else 2 * size, size)
    assert_balanced(square.tolist(), size)


def test_single_condition_has_one_row():
    assert make_williams_square(1).tolist() == [[0]]


@pytest.mark.fast_cases(5)
@pytest.mark.parametrize("tasks", range(1, 9))
def test_orders_are_balanced(tasks):
    for conditions in SIZES:
        orders = make_balanced_orders(tasks, conditions, np.random.default_rng(conditions))
        if tasks > 1:
            assert_balanced([[block.task_index for block in order] for order in orders], tasks)
        for group in (_by_task, _by_place):
            for blocks in group(orders):
                assert_balanced([block.condition_indices for block in blocks], conditions)


def _by_task(orders: Iterable[Sequence[TaskBlock]]) -> list[list[TaskBlock]]:
    blocks = [block for order in orders for block in order]
    return [
        [block for block in blocks if block.task_index == task]
        for task in {block.task_index for block in blocks}
    ]


def _by_place(orders: Iterable[Sequence[TaskBlock]]) -> list[Sequence[TaskBlock]]:
    return list(zip(*orders, strict=True))


def test_orders_depend_on_the_seed():
    def orders(seed: int) -> tuple:
        return make_balanced_orders(4, 4, np.random.default_rng(seed))

    assert orders(3) == orders(3)
    assert len({orders(seed) for seed in range(20)}) == 20


# The paper's study


def trials_of_all(design: Design) -> list[tuple[PlannedTrial, ...]]:
    cells = len(make_trial_orders(design))
    return [plan_trials(design, number % cells, number + 1) for number in range(design.participants)]


def test_protocol_of_the_paper_has_sixteen_trials():
    plans = trials_of_all(PAPER)
    assert len(plans) == 8
    for trials in plans:
        assert [trial.position for trial in trials] == list(range(1, 21))
        assert [trial.practice for trial in trials] == [True, False, False, False, False] * 4
        assert Counter((t.environment, t.policy) for t in trials if not t.practice) == Counter(
            {
                (environment, policy): 1
                for environment in PAPER_ENVIRONMENTS
                for policy in ("original", "revised")
            }
        )
        assert {trial.policy for trial in trials if trial.practice} == {"revised"}
        for start in range(0, 20, 5):
            assert len({_task(trial) for trial in trials[start : start + 5]}) == 1


def _task(trial: PlannedTrial) -> str:
    return ENVIRONMENTS[trial.environment][0]


def _robot(trial: PlannedTrial) -> str:
    return ENVIRONMENTS[trial.environment][1]


def _policy(trial: PlannedTrial) -> str:
    return trial.policy


@pytest.mark.parametrize("factor", [_task, _robot, _policy])
def test_protocol_of_the_paper_is_balanced(
    factor: Callable[[PlannedTrial], str],
):
    plans = [[trial for trial in trials if not trial.practice] for trials in trials_of_all(PAPER)]
    places = Counter((place, factor(trial)) for trials in plans for place, trial in enumerate(trials))
    assert len(set(places.values())) == 1
    changes = Counter(
        (factor(a), factor(b))
        for trials in plans
        for a, b in pairwise(trials)
        if factor(a) != factor(b) and (factor is _task or _task(a) == _task(b))
    )
    assert len(set(changes.values())) == 1


def test_seeds_and_practice_robots_are_deterministic():
    plans = trials_of_all(PAPER)
    assert trials_of_all(PAPER) == plans
    seeds = [trial.seed for trials in plans for trial in trials]
    assert len(set(seeds)) == len(seeds)


def test_practice_robots_are_balanced():
    for seed in range(20):
        design = parse_design(read_default_design_text().replace("seed = 0", f"seed = {seed}"))
        practices = [[trial for trial in trials if trial.practice] for trials in trials_of_all(design)]
        by_task = Counter((_task(trial), _robot(trial)) for trials in practices for trial in trials)
        assert by_task == {(task, robot): 4 for task in design.tasks for robot in design.robots}
        for trials in practices:
            assert Counter(_robot(trial) for trial in trials) == {"PR2": 2, "Jaco": 2}


def test_practice_robots_are_random():
    """The design does not determine the practice robot of a task."""
    drawn = [choose_practice_robots(msgspec.structs.replace(PAPER, seed=seed), 3) for seed in range(400)]
    for robots in zip(*drawn, strict=True):
        assert 150 < robots.count("PR2") < 250


def test_no_practice_trials_without_a_practice_policy():
    design = parse_design(
        read_default_design_text().replace('practice_policy = "revised"', 'practice_policy = ""')
    )
    trials = plan_trials(design, 0, 1)
    assert len(trials) == 16
    assert not any(trial.practice for trial in trials)


# Allocation with dropout


@pytest.mark.parametrize("cells", [2, 4, 6, 12])
@pytest.mark.parametrize("stations", [1, 2, 4])
def test_dropout_keeps_completed_cells_balanced(cells, stations):
    rng = np.random.default_rng(cells + 100 * stations)
    target, dropouts = 10 * cells, 0
    completed: list[int] = []
    active: list[int] = []
    while len(completed) < target:
        if len(active) < stations and len(completed) + len(active) < target:
            active.append(find_least_used_order_index(range(cells), completed + active))
            continue
        cell = active.pop(int(rng.integers(len(active))))
        if rng.random() < 0.3:
            dropouts += 1
        else:
            completed.append(cell)
        if stations == 1:
            counts = Counter(completed)
            assert max(counts.values(), default=0) - min(counts[cell] for cell in range(cells)) <= 1
    counts = [completed.count(cell) for cell in range(cells)]
    print(f"{cells} cells, {stations} stations: completed {counts} with {dropouts} dropouts")
    assert max(counts) - min(counts) <= 1
    assert dropouts > cells


# Sites


@pytest.mark.parametrize("sites", [1, 2, 3, 5])
def test_each_site_and_all_sites_are_balanced(sites):
    """With a shared database, the cells of a site differ by at most one participant at any time."""
    rng = np.random.default_rng(sites)
    orders = {f"site-{site}": list_order_indices_for_site(PAPER, f"site-{site}") for site in range(sites)}
    cells = len(orders["site-0"])
    taken: dict[str, list[int]] = {site: [] for site in orders}
    for _ in range(20 * cells):
        site = str(rng.choice(list(orders)))
        elsewhere = [cell for other in orders if other != site for cell in taken[other]]
        taken[site].append(find_least_used_order_index(orders[site], taken[site], elsewhere))
        for own in taken.values():
            counts = [own.count(cell) for cell in range(cells)]
            assert max(counts) - min(counts) <= 1
    everybody = [cell for own in taken.values() for cell in own]
    counts = [everybody.count(cell) for cell in range(cells)]
    print(f"{sites} sites: {counts}")
    assert max(counts) - min(counts) <= max(1, sites - 1)


@pytest.mark.slow
def test_sites_begin_with_different_cells():
    firsts = Counter(list_order_indices_for_site(PAPER, f"site-{number}")[0] for number in range(400))
    assert all(60 < firsts[cell] < 140 for cell in range(4))


def test_orders_without_a_site_are_unchanged():
    assert list_order_indices_for_site(PAPER, None) == list(range(4))
    assert plan_trials(PAPER, 1, 3, None) == plan_trials(PAPER, 1, 3, "") == plan_trials(PAPER, 1, 3)


def test_sites_have_different_seeds():
    atlanta, berlin = (plan_trials(PAPER, 1, 3, site) for site in ("atlanta", "berlin"))
    assert not {trial.seed for trial in atlanta} & {trial.seed for trial in berlin}
    assert [(each.environment, each.policy) for each in atlanta] == [
        (each.environment, each.policy) for each in berlin
    ]
