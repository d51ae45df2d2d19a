"""Checking a study: whether its robots leave everybody room where trials begin."""

from collections.abc import Iterator
from itertools import product

from avrgym.study.checking.finding import Finding
from avrgym.study.storage.store import Store
from avrgym.tasks.known import environment_id
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.tasks.starts import draws_by_body


def check_starts(store: Store) -> Iterator[Finding]:
    """Finds bodies that have no start in an environment of the design, or whose starts are drawn too often.

    A few starts are drawn for each body, as short and as tall as anybody is measured.
    """
    for task, robot in product(store.design.tasks, store.design.robots):
        environment = environment_id(task, robot)
        if environment in ENVIRONMENTS:
            yield from _check_environment(environment)


def _check_environment(environment: str) -> Iterator[Finding]:
    try:
        drawn_starts = draws_by_body(environment)
    except Exception as error:  # other people's code may raise anything
        yield Finding(environment, f"no start can be drawn: {type(error).__name__}: {error}")
        return
    for person, drawn in drawn_starts:
        if drawn.refused:
            yield Finding(environment, drawn.refused.removeprefix(f"{environment}: "))
        elif drawn.fault:
            body = f"a {person.sex} with a torso of {person.torso_height_m:.2f} m"
            yield Finding(environment, f"next to {body} {drawn.fault}", wrong=False)
