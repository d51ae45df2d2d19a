"""Allocation of participants to orders, and their planned trials."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from avrgym.study.design.counterbalancing import Block, Order, balanced_orders
from avrgym.study.design.design import Design
from avrgym.system import random_streams
from avrgym.tasks.constants import environment_id


@dataclass(frozen=True)
class PlannedTrial:
    """One trial to run; ``position`` counts a participant's trials from 1, practice included."""

    position: int
    environment: str
    policy: str
    seed: int
    practice: bool


def cell_orders(design: Design) -> tuple[Order, ...]:
    """The order of each cell of the design, from its seed."""
    return _cell_orders(len(design.tasks), len(design.conditions), design.seed)


@cache
def _cell_orders(tasks: int, conditions: int, seed: int) -> tuple[Order, ...]:
    return balanced_orders(tasks, conditions, random_streams.condition_orders(seed))


def least_filled_cell(order: Sequence[int], taken: Iterable[int], elsewhere: Iterable[int] = ()) -> int:
    """The cell of the next participant; each site is a block.

    Args:
        order: all cells; the first of equally filled cells is chosen.
        taken: the cells of participants at the same site.
        elsewhere: the cells of participants at other sites, used where cells of the site are equally filled.
    """
    here, others = Counter(taken), Counter(elsewhere)
    return min(order, key=lambda cell: (here[cell], others[cell]))


def cell_fill_order(design: Design, site: str | None) -> list[int]:
    """The order in which a site fills the cells of a design.

    It differs between sites: sites with few participants then fill different cells.
    """
    cells = len(cell_orders(design))
    if site is None:
        return list(range(cells))
    rng = random_streams.site_cells(design.seed, site)
    return [int(cell) for cell in rng.permutation(cells)]


def plan_trials(
    design: Design, cell: int, participant: int, site: str | None = None
) -> tuple[PlannedTrial, ...]:
    """All trials of a participant by cell, number and site: a practice trial before each task, then its trials.

    Practice robots and seeds of trials differ between participants. Both depend on the design's seed.
    """
    rng = random_streams.trial_seeds(design.seed, participant, site)
    robots_of_tasks = practice_robots(design, participant)
    trials: list[PlannedTrial] = []
    for block in cell_orders(design)[cell]:
        for robot, policy, practice in _conditions(design, block, robots_of_tasks[block.task]):
            environment = environment_id(design.tasks[block.task], robot)
            seed = int(rng.integers(1 << 31))
            trials.append(PlannedTrial(len(trials) + 1, environment, policy, seed, practice))
    return tuple(trials)


def practice_robots(design: Design, participant: int) -> tuple[str, ...]:
    """The practice robot of a participant (number from 1) for each task of the design.

    Random and balanced. In each group of as many participants as robots, each has a different robot in a task. Each
    participant practises with each robot in equally many tasks, or in one more.
    """
    robots = len(design.robots)
    group, place = divmod(participant - 1, robots)
    rng = random_streams.practice_robots(design.seed, group)
    shifts = rng.permutation(np.arange(len(design.tasks)) % robots)
    return tuple(design.robots[int(index)] for index in (rng.permutation(robots)[place] + shifts) % robots)


def _conditions(design: Design, block: Block, practice_robot: str) -> list[tuple[str, str, bool]]:
    practice = [(practice_robot, design.practice_policy, True)] if design.practice_policy else []
    return practice + [(*design.conditions[index], False) for index in block.conditions]
