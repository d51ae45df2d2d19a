"""A hosted study: the way of a participant, and sessions in processes that crash and are replaced."""

import os
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from avrgym.hosting import participant_app, session_pool
from avrgym.hosting.data_requests import DeletionThread
from avrgym.hosting.host import StudyHost
from avrgym.study.storage.sessions import open_session
from avrgym.study.storage.state_transitions import LostConnectionError
from avrgym.study.storage.store import StudyStore, change_state
from avrgym.vr.protocol.messages import Language, PhaseDescription, Problem, Welcome
from helpers.hosting.served_host import Served, first, wait_until
from helpers.studies.small_studies import run_trial, small_study

pytestmark = pytest.mark.slow


def test_way_of_a_participant_from_the_invitation_to_the_session(served: Served) -> None:
    """Each step is stored, and each later step is refused before it."""
    store: StudyStore = served.host.store
    answer = served.post("invitation", token=served.invite())
    assert answer.json()["title"] == store.design.title
    pseudonym, token = served.enrol()
    shown = served.stage(token)
    assert (shown["type"], shown["version"]) == ("consent", store.design.consent.version)
    assert [served.post(name, token).status_code for name in ("safety", "waiting-list")] == [409, 409]
    changed = served.post("consent", token, version=shown["version"], sha256="0", agreed=True)
    assert changed.status_code == 409
    agreed = {"version": shown["version"], "sha256": shown["sha256"], "agreed": True}
    assert served.post("consent", token, **agreed).status_code == 204
    (consent,) = store.read_consents(pseudonym)
    assert (consent.sha256, consent.version) == (shown["sha256"], shown["version"])
    questions = served.stage(token)["questions"]
    assert [each[0] for each in questions] == [each.id for each in store.design.inclusion]
    answers = {each.id: each.required for each in store.design.inclusion}
    assert served.post("inclusion", token, answers=answers).status_code == 204
    assert served.stage(token) == {"type": "safety"}
    assert served.post("safety", token).status_code == 204
    assert served.stage(token)["type"] == "ready"
    code = served.post("code", token).json()["code"]
    assert served.post("headset", code=code).json()["token"] == token
    assert served.post("headset", code=code).status_code == 403


def test_endings_have_their_own_codes(served: Served) -> None:
    pseudonym, token = served.enrol()
    shown = served.stage(token)
    declined = {"version": shown["version"], "sha256": shown["sha256"], "agreed": False}
    assert served.post("consent", token, **declined).status_code == 204
    assert served.stage(token) == {"type": "ended", "ending": "withdrawn", "code": "LEFT", "redirect": ""}
    assert served.host.store.read_participant(pseudonym).state == "withdrawn"
    _, other = served.enrol()
    shown = served.stage(other)
    served.post("consent", other, version=shown["version"], sha256=shown["sha256"], agreed=True)
    answers = {each.id: not each.required for each in served.host.store.design.inclusion}
    assert served.post("inclusion", other, answers=answers).status_code == 204
    assert served.stage(other)["code"] == "OUT"


def test_data_are_deleted_on_request_while_no_session_runs(served: Served) -> None:
    """A copy is only requested: an experimenter hands it over."""
    store = served.host.store
    pseudonym, token = served.admit()
    assert served.post("copy", token).status_code == 204
    experimenter = served.host.tokens.experimenter
    view = served.request("GET", "/api/sessions", experimenter, experimenter=True).json()
    assert pseudonym in view["copies_requested"]
    assert served.post("deletion", token).status_code == 204
    assert served.stage(token)["ending"] == "withdrawn"
    DeletionThread(store, served.host.pool).poll()
    assert [each.number for each in store.read_deleted_participants()] == [
        int(pseudonym.removeprefix("sub-"))
    ]
    wait_until(
        lambda: served.request("GET", "/api/stage", token).status_code == 401, "the token becomes invalid"
    )
    assert store.database.find_integrity_errors() == []


def test_killed_session_is_replaced_with_the_same_link(served: Served) -> None:
    session, token = served.start()
    with served.connect(session.id, session.link_token) as socket:
        welcome = first(socket)
        assert isinstance(welcome, Welcome)
        assert welcome.session == f"{session.pseudonym} ses-01"
        os.kill(session.process.pid or 0, signal.SIGKILL)
    wait_until(lambda: session.crashes == 1 and session.server_address, "the process is replaced")
    assert served.stage(token)["path"] == f"session/{session.id}/"
    with served.connect(session.id, session.link_token) as socket:
        welcome = first(socket)
        assert isinstance(welcome, Welcome)
        assert welcome.session == f"{session.pseudonym} ses-02"
    states = [each.state for each in served.host.store.read_sessions(session.pseudonym)]
    assert states == ["interrupted", "open"]
    served.post("withdrawal", token)
    wait_until(
        lambda: served.host.pool.find_participant_session(session.pseudonym) is None, "the session ends"
    )
    assert served.stage(token)["code"] == "LEFT"
    assert served.host.store.database.find_integrity_errors() == []


def test_participant_is_completed_after_a_crash_at_the_end(served: Served) -> None:
    """All trials are complete, and the session was killed before it stored its end."""
    store = served.host.store
    pseudonym, token = served.admit()
    session = open_session(store, pseudonym)
    for trial in store.read_remaining_trials(pseudonym):
        run_trial(store, session, trial, simulated=False)
    with store.database.write_transaction() as connection:
        change_state(connection, session, "interrupted", {"session": session.id})
    assert store.read_participant(pseudonym).state == "allocated"
    assert served.stage(token)["code"] == "DONE"
    assert store.read_participant(pseudonym).state == "completed"


def test_waiting_and_absent_participants(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """With full capacity a participant waits. The session of an absent participant ends, and can be started again."""
    pool = served.host.pool
    monkeypatch.setattr(pool, "_max_sessions", 1)
    session, token = served.start()
    pseudonym, waiting = served.admit()
    assert served.post("waiting-list", waiting).status_code == 204
    stage = served.stage(waiting)
    assert (stage["type"], stage["ahead"]) == ("waiting", 0)
    assert 1 <= stage["minutes"] <= pool.estimated_session_duration_s / 60.0 + 1.0
    session.absence_start_time_s = session_pool.time.monotonic() - 3600.0
    wait_until(
        lambda: pool.find_participant_session(session.pseudonym) is None,
        "the session of the absent person ends",
    )
    assert served.host.store.read_sessions(session.pseudonym)[0].state == "closed"
    assert served.stage(token)["type"] == "ready"
    own = wait_until(
        lambda: pool.find_participant_session(pseudonym), "the session of the waiting person starts"
    )
    served.post("withdrawal", waiting)
    wait_until(lambda: pool.find_session(own.id) is None, "the session ends")


def test_experimenter_sees_and_commands_all_sessions(served: Served) -> None:
    session, token = served.start()
    experimenter = served.host.tokens.experimenter

    def ask(method: str, path: str, **body: object) -> int:
        return served.request(
            method, path, experimenter, experimenter=True, **({"json": body} if body else {})
        ).status_code

    def view() -> dict:
        return served.request("GET", "/api/sessions", experimenter, experimenter=True).json()

    with served.connect(session.id, session.link_token) as participant:
        wait_until(lambda: session.report.is_connected, "the participant is connected")
        (shown,) = [each for each in view()["sessions"] if each["id"] == session.id]
        assert (shown["participant"], shown["phase"], shown["trials"]) == (session.pseudonym, "waiting", 5)
        assert shown["warnings"] == []
        assert view()["participants"] == Counter(each.state for each in served.host.store.read_participants())
        with served.connect(session.id, experimenter, "watch", experimenter=True) as watch:
            assert isinstance(first(watch), Welcome)
        assert ask("POST", f"/api/sessions/{session.id}/message", text="Please sit down") == 204
        heard = [first(participant)]
        while not isinstance(heard[-1], Problem):
            heard.append(first(participant))
        assert heard[-1].message == "Please sit down"
        assert any(isinstance(each, Language) for each in heard)
        assert ask("POST", f"/api/sessions/{session.id}/end") == 204
        while not isinstance(heard[-1], PhaseDescription) or heard[-1].name != "finished":
            heard.append(first(participant))
    wait_until(lambda: served.host.pool.find_session(session.id) is None, "the session ends")
    assert ask("POST", f"/api/sessions/{session.id}/end") == 409
    assert ask("POST", "/api/door", is_open=False) == 204
    assert served.stage(token)["is_open"] is False
    assert served.post("waiting-list", token).status_code == 409
    assert served.post("invitation", token=served.invite()).json()["reason"] == "closed"
    assert ask("POST", "/api/door", is_open=True) == 204
    names = {each.action for each in served.host.store.read_audit_log()}
    assert {"end session", "send message", "close door", "open door"} <= names


def test_requests_of_an_address_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong invitations and codes count together; a right invitation is refused too."""
    monkeypatch.setattr(participant_app, "MAX_ADDRESS_BURST_REQUESTS", 5)
    with StudyStore(small_study(tmp_path / "study")) as store, StudyHost(store) as host:
        limited = Served(host)
        wrong = [limited.post("invitation", token="x").status_code for _ in range(6)]
        assert wrong == [403] * 5 + [429]
        assert limited.post("invitation", token=limited.invite()).status_code == 429
        assert limited.post("headset", code="12345678").status_code == 429
        assert limited.request("GET", "/api/stage", "x").status_code == 429


def test_requests_are_repeated_when_the_connection_to_the_database_is_lost(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, token = served.enrol()
    shown = served.stage(token)
    lost = ["stage", "consent"]
    known = participant_app.find_stage

    def lose_connection(*arguments: Any, **options: Any) -> Any:
        if lost:
            raise LostConnectionError(lost.pop(0))
        return known(*arguments, **options)

    monkeypatch.setattr(participant_app, "find_stage", lose_connection)
    assert served.stage(token) == shown
    lost = ["consent"]
    agreed = {"version": shown["version"], "sha256": shown["sha256"], "agreed": True}
    assert served.post("consent", token, **agreed).status_code == 204
    lost = ["the database is away"] * 3
    assert served.request("GET", "/api/stage", token).status_code == 503
    assert served.stage(token)["type"] == "inclusion"
