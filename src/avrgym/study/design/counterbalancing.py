"""Counterbalance the orders of tasks and conditions by Williams squares.

A Williams square is a Latin square: each condition is equally often at each position. It is also equally often after
each other condition. For an odd number of conditions, the square has twice as many rows. Source: Williams,
*Experimental designs balanced for the estimation of residual effects of treatments*, 1949.
"""

from dataclasses import dataclass
from math import lcm

import numpy as np

from avrgym.array_types import IntArray


@dataclass(frozen=True)
class TaskBlock:
    """One task of a participant, with its conditions in order. ``task_index`` and ``condition_indices`` are indices
    from 0.
    """

    task_index: int
    condition_indices: tuple[int, ...]


RANDOM_ARRANGEMENT_COUNT = 200
"""Number of random arrangements to compare. The arrangement whose trial orders contain the most different rows of the
Williams square is used.
"""

TrialOrder = tuple[TaskBlock, ...]
"""The trial order of a participant: the task blocks in order."""


def make_williams_square(size: int) -> IntArray:
    """Returns a Williams square (size, size) of the numbers 0 to ``size`` − 1; for an odd size above 1, (2 size,
    size).
    """
    zigzag = [(i + 1) // 2 if i % 2 else -(i // 2) for i in range(size)]
    rows = (np.array(zigzag, np.intp) + np.arange(size)[:, None]) % size
    return np.concatenate([rows, rows[:, ::-1]]) if size % 2 and size > 1 else rows


def make_balanced_orders(tasks: int, conditions: int, rng: np.random.Generator) -> tuple[TrialOrder, ...]:
    """Returns balanced trial orders for these numbers of tasks and conditions. A *cell* is the index of an order.

    Over all cells, the order of tasks is balanced as in a Williams square. The order of conditions is balanced in the
    same way: over the blocks of each task, and over the blocks at each place.
    """
    task_rows = _shuffled_square(tasks, rng)
    condition_rows = _shuffled_square(conditions, rng)
    cells = lcm(len(task_rows), len(condition_rows))
    task_of = np.tile(task_rows, (cells // len(task_rows), 1))
    spreads = [
        _spread(rng.permutation(tasks)[task_of], len(condition_rows)) for _ in range(RANDOM_ARRANGEMENT_COUNT)
    ]
    row_of = max(spreads, key=_variety)
    return tuple(
        tuple(
            TaskBlock(int(task), tuple(condition_rows[row].tolist()))
            for task, row in zip(tasks, rows, strict=True)
        )
        for tasks, rows in zip(task_of, row_of, strict=True)
    )


def _shuffled_square(size: int, rng: np.random.Generator) -> IntArray:
    """Returns a Williams square with randomly permuted symbols and rows. It is still balanced."""
    return rng.permutation(rng.permutation(size)[make_williams_square(size)])


def _variety(row_of: IntArray) -> int:
    """Returns the number of different rows of the Williams square in a cell, summed over all cells.

    ``row_of`` (cells, places): row of each block. A cell is the index of a trial order.
    """
    return sum(len(set(rows)) for rows in row_of.tolist())


def _spread(task_of: IntArray, rows: int) -> IntArray:
    """Returns, for each block, a row index (cells, places) in the Williams square of conditions with ``rows`` rows.

    ``task_of`` (cells, places): the task of each block. Each task must occur equally often at each place.

    Each row occurs equally often at each place and for each task. Proof: tasks and places are the two sides of a
    regular bipartite graph; each block is an edge. Each block has two numbers: the distance between task and place, and
    the number of earlier cells with this task at this place. Blocks with equal numbers are a perfect matching. The
    matchings distribute the rows evenly.
    """
    cells, places = map(int, task_of.shape)
    earlier = np.array(
        [(task_of[:cell] == task_of[cell]).sum(axis=0) for cell in range(cells)], np.intp
    ).reshape(cells, places)
    shift = (task_of - np.arange(places)) % places
    return (shift + places * earlier) % rows
