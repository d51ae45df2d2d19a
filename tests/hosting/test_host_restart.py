"""A host that is killed and started again: its door, its waiting list and its sessions."""

from contextlib import suppress
from pathlib import Path

import pytest
from websockets.exceptions import WebSocketException

from avrgym.hosting.host import StudyHost
from avrgym.hosting.host_state import HOST_STATE_FILE, HostState, RunningSession
from avrgym.hosting.waiting_list import PRESENCE_TIMEOUT_S, WaitingList
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol.messages import Welcome
from helpers.hosting.served_host import Served, first, host_process, wait_until
from helpers.studies.small_studies import small_study


def greeting(served: Served, session_id: str, link: str) -> str:
    """The name of a session, after a connection with its link."""

    def connect() -> str:
        with suppress(OSError, WebSocketException), served.connect(session_id, link) as socket:
            welcome = first(socket)
            assert isinstance(welcome, Welcome)
            return welcome.session
        return ""

    return wait_until(connect, "the session welcomes its participant")


@pytest.mark.slow
def test_killed_host_continues_where_it_was(tmp_path: Path) -> None:
    """The participant's page reconnects to its session, the others keep their places, and the door stays closed."""
    folder = small_study(tmp_path / "study")
    (folder / "host.toml").write_text("headset_check = false\n")
    with StudyStore(folder) as store:
        with host_process(store, "--sessions", "1") as (host, served):
            pseudonyms, tokens = zip(*(served.admit() for _ in range(3)), strict=True)
            assert served.post("waiting-list", tokens[0]).status_code == 204
            before = wait_until(
                lambda: (stage := served.stage(tokens[0]))["type"] == "session" and stage, "a session starts"
            )
            link, session_id = before["token"], before["path"].split("/")[1]
            assert greeting(served, session_id, link) == f"{pseudonyms[0]} ses-01"
            for each in tokens[1:]:
                assert served.post("waiting-list", each).status_code == 204
            experimenter = host.tokens.experimenter
            closed = served.request(
                "POST", "/api/door", experimenter, experimenter=True, json={"is_open": False}
            )
            assert closed.status_code == 204
            host.process.kill()
            host.process.wait()
        ports = {"port": host.port, "experimenter_port": host.experimenter_port}
        with host_process(store, "--sessions", "1", **ports) as (_, served):
            with pytest.raises(ValueError, match="is in use by process"), StudyHost(store):
                pass
            assert served.stage(tokens[0]) == before
            assert [served.stage(each)["ahead"] for each in tokens[2:0:-1]] == [1, 0]
            view = served.request("GET", "/api/sessions", experimenter, experimenter=True).json()
            assert view["is_open"] is False
            assert greeting(served, session_id, link) == f"{pseudonyms[0]} ses-02"
        assert store.database.find_integrity_errors() == []


def test_state_is_stored_and_private(tmp_path: Path) -> None:
    state = HostState(tmp_path)
    assert (state.is_study_open, state.waiting_pseudonyms, state.sessions) == (True, (), ())
    session = RunningSession("id", "sub-001", "link", 1.5, 2)
    state.set_study_open(False)
    state.store_sessions(("sub-002",), (session,))
    restored = HostState(tmp_path)
    assert (restored.is_study_open, restored.waiting_pseudonyms, restored.sessions) == (
        False,
        ("sub-002",),
        (session,),
    )
    path = tmp_path / "private" / HOST_STATE_FILE
    assert path.stat().st_mode & 0o077 == 0
    path.write_text("{")
    with pytest.raises(ValueError, match="is damaged"):
        HostState(tmp_path)


def test_restored_places_are_for_participants_who_return() -> None:
    waiting = WaitingList()
    waiting.restore(["a", "b"], 0.0)
    assert (waiting.find_next_present(), waiting.count_participants_ahead("b")) == (None, 1)
    waiting.join("b", 1.0)
    assert waiting.find_next_present() == "b"
    waiting.join("a", 2.0)
    assert waiting.find_next_present() == "a"
    waiting.remove_absent(PRESENCE_TIMEOUT_S + 1.5)
    assert waiting.pseudonyms == ("a",)
