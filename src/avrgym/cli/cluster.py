"""Where long work runs: the option ``--cluster``."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster

Address = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Share the work among the workers of a Ray cluster: `local` for one on this computer, `auto`, HOST:PORT "
        "or ray://HOST:PORT. Changes no result. Needs the extra `cluster`.",
        metavar="ADDRESS",
    ),
]


@contextmanager
def on_cluster(address: str | None, jobs: int | None) -> Generator["Cluster | None"]:
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
