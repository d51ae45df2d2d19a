"""Participants of a study whose sessions run on the nodes of a Ray cluster, while workers and nodes are killed.

Needs Ray, which ``make test-engines`` installs, and a PostgreSQL server. Run it with other numbers:
``python tests/soak/soak_host_cluster.py PARTICIPANTS WORKERS_KILLED NODES_KILLED``.
"""

import json
import os
import signal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

pytest.importorskip("ray", reason="Ray is an extra")

from avrgym.hosting.cluster import RayNode, RayNodes
from avrgym.hosting.session_pool import HostedSession
from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from avrgym.system.cluster import connect
from helpers.hosting.hosted_participants import host_participants
from helpers.learning.ray_nodes import add_node, kill_node, ray_nodes
from helpers.studies.object_store_server import object_store_server, set_object_store
from helpers.studies.small_studies import new_postgresql_database, postgresql_programs, postgresql_server
from helpers.system.processes import free_port

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray closes its processes and files at shutdown


@pytest.mark.skipif(postgresql_programs() is None, reason="PostgreSQL's server is not installed")
def test_participants_on_two_nodes_with_killed_workers_and_nodes(tmp_path: Path) -> None:
    figures = host_on_cluster(tmp_path / "study", participants=4, workers=2, nodes=2)
    print(json.dumps(figures, indent=2))
    assert figures["completed"] == 4
    assert (figures["killed"], figures["nodes_killed"]) == (4, 2)
    assert figures["lost_trials"] == 0
    assert figures["faults"] == []


@contextmanager
def services() -> Iterator[None]:
    """Run a database and an object store, and set the environment variables with their addresses."""
    programs, port = postgresql_programs(), free_port()
    assert programs is not None, "PostgreSQL's server is not installed"
    with (
        postgresql_server(programs) as server,
        object_store_server(port),
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setenv(DATABASE_URL_VARIABLE, new_postgresql_database(server))
        set_object_store(patch, port)
        yield


def host_on_cluster(folder: Path, participants: int, workers: int, nodes: int) -> dict[str, Any]:
    """Host a study on a cluster of two nodes. Kill processes of sessions, then nodes. Returns figures."""
    killed_nodes: list[str] = []
    with services(), ray_nodes(1, 1) as cluster, connect(cluster.address) as connected:

        def kill(session: HostedSession) -> None:
            if workers > len(killed_workers):
                killed_workers.append(session.id)
                os.kill(session.process.pid or 0, signal.SIGKILL)
                return
            assert isinstance(session.computer, RayNode)
            killed_nodes.append(session.computer.name)
            node = next(each for each in cluster.worker_nodes if each.node_id == session.computer.name)
            kill_node(node)
            cluster.worker_nodes.remove(node)
            add_node(cluster, 1)

        killed_workers: list[str] = []
        figures = host_participants(
            folder, participants, workers + nodes, lambda store: RayNodes(store, connected), kill
        )
    return figures | {"nodes_killed": len(set(killed_nodes))}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        figures = host_on_cluster(Path(temporary) / "study", *map(int, sys.argv[1:4]))
        print(json.dumps(figures, indent=2))
