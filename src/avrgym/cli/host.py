"""The command ``avrgym host``."""

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from avrgym.cli.audit_log import log_start_and_end
from avrgym.cli.options import connect_cluster
from avrgym.cli.participant_names import unlock_identity_file
from avrgym.cli.terminal import print_line, report_errors
from avrgym.vr.server.network_addresses import DEFAULT_PORT, LOOPBACK_HOSTS

if TYPE_CHECKING:
    from avrgym.hosting.cluster import RayNodes
    from avrgym.study.storage.store import StudyStore
    from avrgym.system.cluster import Cluster


def host(
    study: Annotated[Path, typer.Argument(help="The study's folder.", metavar="STUDY")],
    address: Annotated[
        str,
        typer.Option(help="The public address, such as https://study.org; default: this computer only."),
    ] = "",
    port: Annotated[
        int, typer.Option(help="The port for participants; 0 chooses a free one.", min=0, max=65535)
    ] = DEFAULT_PORT,
    experimenter_port: Annotated[
        int,
        typer.Option(
            help="The port for experimenters, on this computer only; 0 chooses a free one.",
            min=0,
            max=65535,
        ),
    ] = DEFAULT_PORT + 1,
    listen: Annotated[
        str, typer.Option(help="The address to listen on. Addresses other than loopback need --proxy.")
    ] = LOOPBACK_HOSTS[0],
    proxy: Annotated[
        list[str] | None,
        typer.Option(
            help="The address of a reverse proxy with TLS. Its X-Forwarded-For header is trusted. Repeatable."
        ),
    ] = None,
    sessions: Annotated[
        int | None,
        typer.Option(
            help="Maximum number of concurrent sessions; default: the measured capacity of the computers.",
            min=1,
        ),
    ] = None,
    cluster: Annotated[
        str | None,
        typer.Option(
            help="Run sessions on the nodes of a Ray cluster: `local`, `auto`, HOST:PORT or ray://HOST:PORT. Needs "
            "PostgreSQL, an object store, and the extra `cluster`.",
            metavar="ADDRESS",
        ),
    ] = None,
) -> None:
    """Host a study for participants at home: concurrent sessions.

    Participants open the links of `study invite`. Set codes and time limits in the file host.toml in the study's
    folder.
    """
    from avrgym.hosting.host import StudyHost
    from avrgym.study.storage.store import StudyStore

    with report_errors():
        unlock_identity_file(study)
        with (
            connect_cluster(cluster, None) as connected,
            StudyStore(study) as store,
            nullcontext(_nodes(store, connected)) as computers,
            log_start_and_end(store, "start host", "stop host"),
            StudyHost(
                store,
                address=address,
                host=listen,
                port=port,
                experimenter_port=experimenter_port,
                max_sessions=sessions,
                proxies=tuple(proxy or ()),
                computers=computers,
            ) as running,
        ):
            print_line("Participants: the links of")
            print_line(f"    avrgym study invite {study} --address {running.public_url} --out links.csv")
            print_line("Experimenter (on this computer; do not give this address to participants)")
            print_line(f"    {running.experimenter_url}")
            print_line("Stop with Ctrl+C.")
            try:
                running.wait()
            except KeyboardInterrupt:
                print_line("stopped")


def _nodes(store: "StudyStore", cluster: "Cluster | None") -> "RayNodes | None":
    """Returns the cluster nodes that run sessions; ``None`` if ``cluster`` is ``None``."""
    if cluster is None:
        return None
    from avrgym.hosting.cluster import RayNodes

    return RayNodes(store, cluster)
