"""Options that several commands share."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.people import population_names
from avrgym.policies.policy_names import POLICY_CHOICES_TEXT
from avrgym.system.engine_names import ENGINE_CHOICES

if TYPE_CHECKING:
    from avrgym.system.cluster import Cluster as ConnectedCluster

ALLOWED_PEOPLE_TEXT = population_names.ALLOWED_PEOPLE_TEXT
PolicyOption = Annotated[str, typer.Option(help=f"The policy that drives the robot: {POLICY_CHOICES_TEXT}.")]
ImpairmentOption = Annotated[
    str,
    typer.Option(help=f"An impairment of the people's motion: {population_names.ALLOWED_IMPAIRMENTS_TEXT}."),
]
SeedOption = Annotated[int, typer.Option(help="Random seed. The same seed gives the same metrics.", min=0)]
WithdrawAfterSuccessOption = Annotated[
    bool,
    typer.Option(
        "--withdraw-after-success",
        help="Withdraw the tool after success in tasks that end with success, as in live sessions.",
    ),
]
ForceGuardOption = Annotated[
    bool,
    typer.Option(
        "--force-guard", help="Limit contact force and approach speed of the arms, as in live sessions."
    ),
]
PortOption = Annotated[
    int, typer.Option(help="The port to listen on; 0 chooses a free one.", min=0, max=65535)
]
LanOption = Annotated[
    bool,
    typer.Option("--lan", help="Also serve the local network, over TLS with a self-signed certificate."),
]
SettingsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        help="A setting of the environment, such as control_hz=20; repeatable. An unknown name prints all settings.",
        metavar="NAME=VALUE",
    ),
]
AllowOtherSettingsOption = Annotated[
    bool,
    typer.Option("--allow-other-settings", help="Allow a policy that was trained with other settings."),
]
EpisodeStepsOption = Annotated[int, typer.Option(help="Number of control steps of an episode.", min=1)]
EngineOption = Annotated[str, typer.Option(help=f"The physics engine: {ENGINE_CHOICES}.")]
ClusterOption = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        help="Run on the workers of a Ray cluster: `local` (a new cluster on this computer), `auto`, HOST:PORT or "
        "ray://HOST:PORT. Does not change results. Needs the extra `cluster`.",
        metavar="ADDRESS",
    ),
]


def select_environments(environments: list[str] | None, every: bool) -> list[str]:
    """Returns the ids of the given environments, or of all environments if ``every`` is true.

    Raises:
        ValueError: if no environment is given, or for an unknown environment; the message lists the allowed names.
    """
    from avrgym.tasks.registry import ENVIRONMENTS, find_environment

    if every:
        return list(ENVIRONMENTS)
    if not environments:
        raise ValueError(f"no environment was given; allowed: --all, or some of {', '.join(ENVIRONMENTS)}")
    for environment in environments:
        find_environment(environment)
    return environments


@contextmanager
def connect_cluster(address: str | None, jobs: int | None) -> Generator["ConnectedCluster | None"]:
    """Context manager: yields a connection to the Ray cluster at ``address``, or ``None`` without an address.

    Raises:
        RuntimeError: if no cluster answers.
    """
    if address is None:
        yield None
        return
    from avrgym.system.cluster import connect_to_cluster

    with connect_to_cluster(address, jobs) as cluster:
        yield cluster
