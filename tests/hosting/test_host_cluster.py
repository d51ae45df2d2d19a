"""Sessions of a hosted study on the nodes of a Ray cluster. Needs Ray, which ``make test-engines`` installs."""

from pathlib import Path

import pytest

pytest.importorskip("ray", reason="Ray is an extra")
pytest.importorskip("boto3", reason="the object store is an extra")

from avrgym.hosting import cluster
from avrgym.hosting.cluster import RayNode, RayNodes
from avrgym.hosting.host import StudyHost
from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from avrgym.study.storage.object_store import OBJECT_STORE_VARIABLE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.cluster import Cluster, connect_to_cluster
from avrgym.vr.protocol.messages import Welcome
from helpers.hosting.served_host import Served, first, wait_until
from helpers.hosting.services import database_and_object_store
from helpers.learning.ray_nodes import kill_node_named, ray_nodes
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray closes its processes and files at shutdown
def test_a_session_continues_on_another_node_with_the_same_link(tmp_path: Path) -> None:
    folder = small_study(tmp_path / "study")
    (folder / "host.toml").write_text("headset_check = false\n")
    with (
        database_and_object_store(),
        ray_nodes(1, 1) as nodes,
        connect_to_cluster(nodes.address) as connected,
        StudyStore(folder) as store,
        StudyHost(store, computers=RayNodes(store, connected)) as host,
    ):
        served = Served(host)
        session, token = served.start()
        with served.connect(session.id, session.link_token) as socket:
            assert isinstance(first(socket), Welcome)
        before, stage = session.computer, served.stage(token)
        assert isinstance(before, RayNode)
        kill_node_named(nodes, before.node_id)
        wait_until(lambda: session.computer is not before and session.server_address, "the session continues")
        assert session.crashes == 1
        assert served.stage(token) == stage
        with served.connect(session.id, session.link_token) as socket:
            assert isinstance(first(socket), Welcome)
        states = [each.state for each in store.read_sessions(session.pseudonym)]
        assert states == ["interrupted", "open"]


def test_nodes_get_neither_names_nor_recordings(tmp_path: Path) -> None:
    with StudyStore(small_study(tmp_path / "study")) as store:
        run_participant(store, enrol_with_consent(store, simulated=False, name="Ann"), 1, simulated=False)
        (store.folder / "private" / "tokens.json").write_text("{}")
        sent = cluster.pack_session_files(store)
    assert sorted(name for name, _ in sent.files) == ["private/tokens.json", "study.toml"]


def test_a_cluster_needs_postgresql_and_an_object_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(DATABASE_URL_VARIABLE, raising=False)
    monkeypatch.delenv(OBJECT_STORE_VARIABLE, raising=False)
    with StudyStore(small_study(tmp_path / "study")) as store:
        with pytest.raises(StudyError, match="--cluster needs a PostgreSQL database"):
            RayNodes(store, Cluster("local", None))
        monkeypatch.setenv(DATABASE_URL_VARIABLE, "postgresql://user@10.0.0.1/name")
        with pytest.raises(StudyError, match="--cluster needs an object store"):
            RayNodes(store, Cluster("local", None))
