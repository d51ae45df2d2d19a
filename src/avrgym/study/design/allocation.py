"""Allocate participants to trial orders (counterbalancing), and plan their trials."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from avrgym.study.design.counterbalancing import TaskBlock, TrialOrder, make_balanced_orders
from avrgym.study.design.design import Design
from avrgym.system import random_streams
from avrgym.tasks.constants import make_environment_id


@dataclass(frozen=True)
class PlannedTrial:
    """A planned trial. ``position``: number of the trial for this participant, from 1, practice trials included."""

    position: int
    environment: str
    policy: str
    seed: int
    practice: bool


def make_trial_orders(design: Design) -> tuple[TrialOrder, ...]:
    """Returns all balanced trial orders of the design. A cell is the index of an order in this tuple."""
    return _cell_orders(len(design.tasks), len(design.robot_policy_pairs), design.seed)


@cache
def _cell_orders(tasks: int, conditions: int, seed: int) -> tuple[TrialOrder, ...]:
    return make_balanced_orders(tasks, conditions, random_streams.make_condition_order_rng(seed))


def find_least_used_order_index(
    order: Sequence[int], cells_at_site: Iterable[int], cells_elsewhere: Iterable[int] = ()
) -> int:
    """Returns the cell (index of a trial order) for the next participant: the least used cell at their site.

    Args:
        order: all cells; among equal cells, the first in this order is returned.
        cells_at_site: the cells of participants at the same site.
        cells_elsewhere: the cells of participants at other sites. They decide if several cells are equal at this site.
    """
    here, others = Counter(cells_at_site), Counter(cells_elsewhere)
    return min(order, key=lambda cell: (here[cell], others[cell]))


def list_order_indices_for_site(design: Design, site: str | None) -> list[int]:
    """Returns all cells (indices of trial orders) of the design, in the order in which a site uses them.

    The order differs between sites. Small sites therefore use different cells.
    """
    cells = len(make_trial_orders(design))
    if site is None:
        return list(range(cells))
    rng = random_streams.make_site_order_rng(design.seed, site)
    return [int(cell) for cell in rng.permutation(cells)]


def plan_trials(
    design: Design, cell: int, participant: int, site: str | None = None
) -> tuple[PlannedTrial, ...]:
    """Returns all trials of a participant: for each task, a practice trial, then the task's trials.

    ``cell``: index of the participant's trial order. ``participant``: participant number. ``site``: name of the site.

    Practice robots and trial seeds differ between participants; both depend on the design's seed.
    """
    rng = random_streams.make_trial_seed_rng(design.seed, participant, site)
    robots_of_tasks = choose_practice_robots(design, participant)
    trials: list[PlannedTrial] = []
    for block in make_trial_orders(design)[cell]:
        for robot, policy, practice in _conditions(design, block, robots_of_tasks[block.task_index]):
            environment = make_environment_id(design.tasks[block.task_index], robot)
            seed = int(rng.integers(1 << 31))
            trials.append(PlannedTrial(len(trials) + 1, environment, policy, seed, practice))
    return tuple(trials)


def choose_practice_robots(design: Design, participant: int) -> tuple[str, ...]:
    """Returns the participant's practice robot for each task of the design; ``participant`` is a number from 1.

    Robots are random and balanced. With R robots, each group of R successive participants practises a task with R
    different robots. For each participant, the numbers of practice trials per robot differ by at most one.
    """
    robots = len(design.robots)
    group, place = divmod(participant - 1, robots)
    rng = random_streams.make_practice_robot_rng(design.seed, group)
    shifts = rng.permutation(np.arange(len(design.tasks)) % robots)
    return tuple(design.robots[int(index)] for index in (rng.permutation(robots)[place] + shifts) % robots)


def _conditions(design: Design, block: TaskBlock, practice_robot: str) -> list[tuple[str, str, bool]]:
    practice = [(practice_robot, design.practice_policy, True)] if design.practice_policy else []
    return practice + [(*design.robot_policy_pairs[index], False) for index in block.condition_indices]
