"""Participants of a study whose sessions run on the nodes of a Ray cluster, while processes and services fail.

Needs Ray, which ``make test-engines`` installs, and a PostgreSQL server. Run it with other numbers:
``python tests/soak/soak_host_cluster.py PARTICIPANTS WORKERS_KILLED NODES_KILLED STORE_STOPS`` with 0 or 1 node.
"""

import json
import os
import signal
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

pytest.importorskip("ray", reason="Ray is an extra")

from avrgym.hosting.cluster import RayNode, RayNodes
from avrgym.hosting.session_pool import HostedSession
from avrgym.system.cluster import connect_to_cluster
from helpers.hosting.hosted_participants import host_participants
from helpers.hosting.services import database_and_object_store
from helpers.learning.ray_nodes import kill_node_named, ray_nodes
from helpers.studies.object_store_server import stop_for
from helpers.studies.small_studies import postgresql_programs

STORE_STOP_S = 60.0
SHORT = {"practice_policy": '""', "trial_steps": "30", "free_movement_s": "0.5"}
pytestmark = pytest.mark.filterwarnings("ignore")  # Ray closes its processes and files at shutdown


@pytest.mark.skipif(postgresql_programs() is None, reason="PostgreSQL's server is not installed")
def test_participants_on_two_nodes_with_killed_workers_and_nodes(tmp_path: Path) -> None:
    figures = host_on_cluster(tmp_path / "study", participants=4, workers=2, nodes=1, store_stops=1)
    print(json.dumps(figures, indent=2))
    assert figures["completed"] == 4
    assert (figures["killed"], figures["lost_trials"], figures["faults"]) == (4, 0, [])


def host_on_cluster(
    folder: Path, participants: int, workers: int, nodes: int, store_stops: int
) -> dict[str, Any]:
    """Host a study on a cluster of two nodes while processes and services fail. Returns figures.

    ``workers``: number of killed processes of sessions. ``nodes``: number of killed nodes, 0 or 1. ``store_stops``:
    number of times at which the object store does not answer for ``STORE_STOP_S``.
    """
    with (
        database_and_object_store() as object_store,
        ray_nodes(1, 1) as cluster,
        connect_to_cluster(cluster.address) as connected,
        ExitStack() as timers,
    ):

        def kill_worker(session: HostedSession) -> None:
            os.kill(session.process.pid or 0, signal.SIGKILL)

        def stop_store(_: HostedSession) -> None:
            timers.callback(stop_for(object_store, STORE_STOP_S).join)

        def kill_its_node(session: HostedSession) -> None:
            assert isinstance(session.computer, RayNode)
            kill_node_named(cluster, session.computer.node_id)

        faults = iter(
            [kill_worker] * workers + [stop_store] * store_stops + [kill_its_node] * nodes,
        )
        return host_participants(
            folder,
            participants,
            workers + nodes + store_stops,
            lambda store: RayNodes(store, connected),
            lambda session: next(faults)(session),
            **SHORT,
        )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        figures = host_on_cluster(Path(temporary) / "study", *map(int, sys.argv[1:5]))
        print(json.dumps(figures, indent=2))
