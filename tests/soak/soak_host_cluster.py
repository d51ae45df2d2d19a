"""Participants of a study whose sessions run on the nodes of a Ray cluster, while workers and a node are killed.

Needs Ray, which ``make test-engines`` installs, and a PostgreSQL server. Run it with other numbers:
``python tests/soak/soak_host_cluster.py PARTICIPANTS WORKERS_KILLED NODES_KILLED`` with 0 or 1 node.
"""

import json
import os
import signal
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))

pytest.importorskip("ray", reason="Ray is an extra")

from avrgym.hosting.cluster import RayNode, RayNodes
from avrgym.hosting.session_pool import HostedSession
from avrgym.system.cluster import connect
from helpers.hosting.hosted_participants import host_participants
from helpers.hosting.services import database_and_object_store
from helpers.learning.ray_nodes import kill_node_named, ray_nodes
from helpers.studies.small_studies import postgresql_programs

pytestmark = pytest.mark.filterwarnings("ignore")  # Ray closes its processes and files at shutdown


@pytest.mark.skipif(postgresql_programs() is None, reason="PostgreSQL's server is not installed")
def test_participants_on_two_nodes_with_killed_workers_and_nodes(tmp_path: Path) -> None:
    figures = host_on_cluster(tmp_path / "study", participants=4, workers=2, nodes=1)
    print(json.dumps(figures, indent=2))
    assert figures["completed"] == 4
    assert (figures["killed"], figures["nodes_killed"]) == (3, 1)
    assert figures["lost_trials"] == 0
    assert figures["faults"] == []


def host_on_cluster(folder: Path, participants: int, workers: int, nodes: int) -> dict[str, Any]:
    """Host a study on a cluster of two nodes. Kill processes of sessions, then 0 or 1 node. Returns figures."""
    killed_nodes: list[str] = []
    with database_and_object_store(), ray_nodes(1, 1) as cluster, connect(cluster.address) as connected:

        def kill(session: HostedSession) -> None:
            if workers > len(killed_workers):
                killed_workers.append(session.id)
                os.kill(session.process.pid or 0, signal.SIGKILL)
                return
            assert isinstance(session.computer, RayNode)
            killed_nodes.append(session.computer.name)
            kill_node_named(cluster, session.computer.name)

        killed_workers: list[str] = []
        figures = host_participants(
            folder, participants, workers + nodes, lambda store: RayNodes(store, connected), kill
        )
    return figures | {"nodes_killed": len(set(killed_nodes))}


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        figures = host_on_cluster(Path(temporary) / "study", *map(int, sys.argv[1:4]))
        print(json.dumps(figures, indent=2))
