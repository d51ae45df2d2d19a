"""Options that several commands share, and the environments that they name."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.people import population_names
from avrgym.policies.names import CHOICES
from avrgym.system.engines import ENGINES

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster as ConnectedCluster

PEOPLE = population_names.ALLOWED_PEOPLE
Policy = Annotated[str, typer.Option(help=f"Who drives: {CHOICES}.")]
Impairment = Annotated[
    str,
    typer.Option(
        help=f"What keeps people from moving as they want: {', '.join(population_names.IMPAIRMENTS)}."
    ),
]
Seed = Annotated[int, typer.Option(help="The same seed gives the same metrics.", min=0)]
WithdrawAfterSuccess = Annotated[
    bool,
    typer.Option(
        "--withdraw-after-success",
        help="Withdraw the tool and wait after success in tasks that end with it, as live sessions do.",
    ),
]
Engine = Annotated[str, typer.Option(help=f"Where physics runs: {ENGINES}.")]
Cluster = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Share the work among the workers of a Ray cluster: `local` for one on this computer, `auto`, HOST:PORT "
        "or ray://HOST:PORT. Changes no result. Needs the extra `cluster`.",
        metavar="ADDRESS",
    ),
]


def chosen_environments(environments: list[str] | None, every: bool) -> list[str]:
    """The environments that were named, or all.

    Raises:
        ValueError: when none was named or one does not exist, naming those that do.
    """
    from avrgym.tasks.registry import ENVIRONMENTS, find_environment

    if every:
        return list(ENVIRONMENTS)
    if not environments:
        raise ValueError(f"name an environment or --all; the environments are {', '.join(ENVIRONMENTS)}")
    for environment in environments:
        find_environment(environment)
    return environments


@contextmanager
def on_cluster(address: str | None, jobs: int | None) -> Generator["ConnectedCluster | None"]:
    """A connection to the cluster that was asked for, if one was.

    Raises:
        RuntimeError: where no cluster answers.
    """
    if address is None:
        yield None
        return
    from avrgym.system.cluster import connected

    with connected(address, jobs) as cluster:
        yield cluster
