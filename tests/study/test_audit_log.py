"""The audit log: each command and view by person and time, and early views of results."""

import csv
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
import sqlalchemy as sa
from typer.testing import CliRunner, Result
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from avrgym.analysis.access_log import AccessLogSummary, render_access_log_section
from avrgym.analysis.report import write_report
from avrgym.analysis.study_analysis import analyse_study
from avrgym.cli.main import app
from avrgym.study.checking.study_checks import check_study
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.dashboard.request_log import LivePageLog
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.export import export_study
from avrgym.study.export.codebook import COLUMNS_BY_TABLE
from avrgym.study.export.event_tables import ExportOptions
from avrgym.study.merge.study_merge import merge_studies
from avrgym.study.people import experimenters
from avrgym.study.people.experimenters import (
    ExperimenterTokens,
    add_experimenter,
    list_experimenters,
    revoke_experimenter,
)
from avrgym.study.people.participant_deletion import delete_participant
from avrgym.study.plan.frozen_plan import read_frozen_plan_evidence
from avrgym.study.plan.plan_deviations import find_deviations
from avrgym.study.sessions.session_threads import StorageThread
from avrgym.study.storage import database, hash_chain, schema
from avrgym.study.storage.audit_log import (
    ADD_EXPERIMENTER_ACTION,
    COMPUTER_ACCOUNT_METHOD,
    IDENTIFICATION_METHODS,
    PERSONAL_TOKEN_METHOD,
    REJECTED_COMMAND_DETAIL,
    SHARED_TOKEN_METHOD,
    AuditActor,
    add_log_entry,
    find_process_user,
)
from avrgym.study.storage.database_rows import AuditLogEntry
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ExperimenterCommand, Hello, Problem, Welcome
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.session.session import Session
from helpers.browser.html_page import Page
from helpers.studies.sites import make_site
from helpers.studies.small_studies import enrol_with_consent, make_study, run_participant, small_study
from helpers.vr.received_states import decode_message
from helpers.vr.visit import constant_policies, plan

ADA, PATIENCE_S = AuditActor("ada", PERSONAL_TOKEN_METHOD), 60.0
NAME, NOTE, REASON = "Grace Participant", "she laughed aloud", "felt unwell today"


@pytest.fixture(autouse=True)
def on_sqlite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    with StudyStore(small_study(tmp_path / "study")) as opened:
        yield opened


@pytest.fixture
def served(
    store: StudyStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[LiveServer[Session], str]]:
    """A server of the study, and the token of the experimenter ada."""
    monkeypatch.setattr(experimenters, "TOKEN_REFRESH_INTERVAL_S", 0.05)
    token = add_experimenter(store, "ada")
    with StorageThread() as storing, ExperimenterTokens(store) as known:
        log = LivePageLog(store, storing, pytest.fail)
        with LiveServer(
            lambda send: Session(plan(), constant_policies(plan()), tmp_path / "free", send, "test"),
            "127.0.0.1",
            0,
            study=lambda tokens, _: make_dashboard_app(store, tokens),
            tokens=StudyTokens.load_for_study(tmp_path / "tokens.json", known, SessionLinks()),
            record=lambda _, caller, message: log.log_message(caller, message, "sub-001"),
        ) as server:
            yield server, token


@contextmanager
def watching(server: LiveServer[Session], token: str) -> Iterator[ClientConnection]:
    """A connected socket of a spectator."""
    with connect(f"ws://127.0.0.1:{server.port}/watch", max_size=None) as socket:
        socket.send(messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True)))
        yield socket


def ask(server: LiveServer[Session], token: str, path: str, body: Any = None) -> httpx.Response:
    url = f"http://127.0.0.1:{server.port}/study{path}"
    method = "GET" if body is None else "POST"
    return httpx.request(
        method, url, json=body, headers={"authorization": f"Bearer {token}"}, timeout=PATIENCE_S
    )


def told(entries: list[AuditLogEntry]) -> list[tuple[str, str, str, int | None, str]]:
    return [(each.person, each.identified_by, each.action, each.participant, each.detail) for each in entries]


def awaited(store: StudyStore, name: str) -> AuditLogEntry:
    """Wait for the entry with this name."""
    discard_attempt = time.monotonic() + PATIENCE_S
    while time.monotonic() < discard_attempt:
        for entry in store.read_audit_log():
            if entry.action == name:
                return entry
        time.sleep(0.01)
    raise TimeoutError(f"no entry {name}")


def command(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


# Who did what


@pytest.mark.slow
def test_dashboard_actions_and_views_are_logged_by_person(
    store: StudyStore, served: tuple[LiveServer[Session], str]
) -> None:
    server, token = served
    new = {"sex": "woman", "name": NAME, "contact": "grace@example.org"}
    assert ask(server, token, "/participants", new).status_code == 200
    assert ask(server, token, "/participants/sub-001/notes", {"text": NOTE}).status_code == 204
    assert ask(server, token, "/participants/sub-001/sessions", {}).status_code == 409
    for _ in range(3):
        assert ask(server, token, "/overview").json()["experimenter"] == "ada"
        assert ask(server, token, "/participants/sub-001").status_code == 200
    shared = server.tokens.experimenter
    assert ask(server, shared, "/overview").json()["experimenter"] == ""
    gone = {"reason": REASON}
    assert ask(server, shared, "/participants/sub-001/withdrawal", gone).status_code == 204
    assert told(store.read_audit_log()) == [
        ("ada", PERSONAL_TOKEN_METHOD, "enrol", 1, ""),
        ("ada", PERSONAL_TOKEN_METHOD, "add note", 1, ""),
        ("ada", PERSONAL_TOKEN_METHOD, "begin session", 1, REJECTED_COMMAND_DETAIL),
        ("ada", PERSONAL_TOKEN_METHOD, "view dashboard", None, ""),
        ("ada", PERSONAL_TOKEN_METHOD, "view participant", 1, ""),
        ("unnamed", SHARED_TOKEN_METHOD, "view dashboard", None, ""),
        ("unnamed", SHARED_TOKEN_METHOD, "withdraw", 1, ""),
    ]
    assert all(entry.recorded_at.endswith("+00:00") for entry in store.read_audit_log())
    assert not [word for word in (NAME, "grace@", NOTE, REASON) if word in repr(store.read_audit_log())]


def test_commands_of_a_running_session_are_logged_by_person(
    store: StudyStore, served: tuple[LiveServer[Session], str]
) -> None:
    server, token = served
    with watching(server, token) as socket:
        first = decode_message(socket, socket.recv(PATIENCE_S))
        assert isinstance(first, Welcome)
        assert first.role == "experimenter"
        socket.send(messages.encode_message(ExperimenterCommand(name="repeat")))
        entry = awaited(store, "repeat")
    with watching(server, server.tokens.experimenter) as socket:
        socket.send(messages.encode_message(ExperimenterCommand(name="end")))
        awaited(store, "end")
    assert told([entry]) == [("ada", PERSONAL_TOKEN_METHOD, "repeat", 1, "")]
    assert told(store.read_audit_log())[-2:] == [
        ("unnamed", SHARED_TOKEN_METHOD, "watch", 1, ""),
        ("unnamed", SHARED_TOKEN_METHOD, "end", 1, ""),
    ]


def test_revoked_token_gives_no_access(store: StudyStore, served: tuple[LiveServer[Session], str]) -> None:
    server, token = served
    with watching(server, token) as socket:
        awaited(store, "watch")
        revoke_experimenter(store, "ada")
        with pytest.raises(ConnectionClosed) as closed:
            hear_on(socket)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 4403
    assert ask(server, token, "/overview").status_code == 401
    with watching(server, token) as socket:
        assert isinstance(decode_message(socket, socket.recv(PATIENCE_S)), Problem)
    assert ask(server, server.tokens.experimenter, "/overview").status_code == 200


def hear_on(socket: ClientConnection) -> None:
    while True:
        socket.recv(PATIENCE_S)


def test_only_the_checksum_of_a_token_is_stored(store: StudyStore) -> None:
    token = add_experimenter(store, "ada")
    with pytest.raises(StudyError, match="ada has a token"):
        add_experimenter(store, "ada")
    for name in ("", "unnamed", "a b", "ü"):
        with pytest.raises(StudyError, match="is not a valid name"):
            add_experimenter(store, name)
    revoke_experimenter(store, "ada")
    with pytest.raises(StudyError, match="has no token"):
        revoke_experimenter(store, "ada")
    again = add_experimenter(store, "ada")
    assert again != token
    assert [bool(each.revoked_at) for each in list_experimenters(store)] == [True, False]
    store.close()
    held = b"".join(path.read_bytes() for path in store.folder.rglob("*") if path.is_file())
    assert token.encode() not in held
    assert again.encode() not in held


def test_commands_are_logged_by_account(tmp_path: Path) -> None:
    folder, who = small_study(tmp_path / "study"), find_process_user()
    assert who.identification_method == COMPUTER_ACCOUNT_METHOD
    assert command("study", "enrol", folder, "--body", "woman", "--name", NAME).exit_code == 0
    assert command("study", "withdraw", folder, "sub-001", "--reason", REASON).exit_code == 0
    added = command("study", "add-experimenter", folder, "ada")
    token = added.stdout.split()[1].rstrip(":")
    assert f"#token={token}" in added.stdout
    assert command("study", "experimenters", folder, "--json", tmp_path / "e.json").exit_code == 0
    (row,) = json.loads((tmp_path / "e.json").read_text())
    assert (row["name"], row["revoked_at"]) == ("ada", None)
    assert command("study", "revoke-experimenter", folder, "ada").exit_code == 0
    assert command("study", "export", folder, "--format", "csv", "--out", tmp_path / "out").exit_code == 0
    assert command("study", "delete-participant", folder, "sub-001").exit_code == 0
    with StudyStore(folder) as store:
        assert told(store.read_audit_log()) == [
            (who.name, COMPUTER_ACCOUNT_METHOD, "enrol", 1, ""),
            (who.name, COMPUTER_ACCOUNT_METHOD, "withdraw", 1, ""),
            (who.name, COMPUTER_ACCOUNT_METHOD, "add experimenter", None, "ada"),
            (who.name, COMPUTER_ACCOUNT_METHOD, "revoke experimenter", None, "ada"),
            (who.name, COMPUTER_ACCOUNT_METHOD, "export", None, "csv"),
            (who.name, COMPUTER_ACCOUNT_METHOD, "delete participant", 1, ""),
        ]
        assert check_study(store) == []


# Only added


@pytest.mark.parametrize(
    "change", ["UPDATE log SET person = 'eve' WHERE id = 1", "DELETE FROM log WHERE id = 1"]
)
def test_edited_log_entry_is_found(store: StudyStore, change: str) -> None:
    for name in ("stop", "repeat"):
        add_log_entry(store, ADA, name)
    assert store.database.find_integrity_errors() == []
    with store.database.write_transaction() as connection:
        connection.execute(sa.text(change))
    assert [where for where, _ in store.database.find_integrity_errors()] == ["log 1"]


def test_duplicate_log_entry_is_found(store: StudyStore) -> None:
    add_log_entry(store, ADA, "stop")
    with store.database.write_transaction() as connection:
        hash_chain.update_row(connection, schema.AUDIT_LOG_TABLE, 1, person="eve")
    assert store.database.find_integrity_errors() == [
        ("log 1", "was changed or deleted; entries of the log must not change")
    ]


def test_log_entries_remain_after_deletion_of_a_participant(store: StudyStore) -> None:
    pseudonym = enrol_with_consent(store)
    add_log_entry(store, ADA, "view participant", pseudonym)
    delete_participant(store, pseudonym)
    assert told(store.read_audit_log()) == [("ada", PERSONAL_TOKEN_METHOD, "view participant", 1, "")]
    assert store.database.find_integrity_errors() == []


# Exports and merged sites


def test_export_contains_the_log_with_a_codebook(store: StudyStore, tmp_path: Path) -> None:
    run_participant(store, enrol_with_consent(store))
    add_log_entry(store, ADA, "repeat", "sub-001")
    add_log_entry(store, ADA, "export", detail="csv", shows_results=True)
    add_log_entry(store, ADA, ADD_EXPERIMENTER_ACTION, detail="eve")
    export_study(store, "csv", tmp_path / "out")
    named = tmp_path / "named"
    export_study(store, "csv", named, extras=ExportOptions(include_free_text=True))
    assert [(row["person"], row["detail"]) for row in read_csv(named / "log.csv")] == [
        ("ada", ""),
        ("ada", "csv"),
        ("ada", "eve"),
    ]
    rows = read_csv(tmp_path / "out" / "log.csv")
    assert list(rows[0]) == list(COLUMNS_BY_TABLE["log"])
    assert [(row["person"], row["name"], row["participant"], row["completed"]) for row in rows] == [
        ("person 1", "repeat", "sub-001", ""),
        ("person 1", "export", "", "1"),
        ("person 1", ADD_EXPERIMENTER_ACTION, "", ""),
    ]
    assert not {"ada", "eve"} & {value for row in rows for value in row.values()}
    described = [
        row["column"] for row in read_csv(tmp_path / "out" / "codebook.csv") if row["table"] == "log"
    ]
    assert described == list(rows[0])
    assert {row["known_by"] for row in rows} <= set(IDENTIFICATION_METHODS)


def read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


def test_logs_of_sites_are_merged_once(tmp_path: Path) -> None:
    folders = [make_site(tmp_path / name, name, trials=(1,)) for name in ("atlanta", "berlin")]
    for folder in folders:
        with StudyStore(folder) as store:
            add_log_entry(store, ADA, "stop", "sub-001")
            add_experimenter(store, "ada")
    out = tmp_path / "all"
    merge_studies(folders, out)
    with StudyStore(out) as store:
        add_log_entry(store, ADA, "analyze")
    merge_studies(folders, out)
    with StudyStore(out) as store:
        assert told(store.read_audit_log()) == [
            ("ada", PERSONAL_TOKEN_METHOD, "analyze", None, ""),
            ("ada", PERSONAL_TOKEN_METHOD, "stop", 1001, ""),
            ("ada", PERSONAL_TOKEN_METHOD, "stop", 2001, ""),
        ]
        assert list_experimenters(store) == []
        assert store.database.find_integrity_errors() == []
        people = analyse_study(store).access_log.people
    assert people == ["ada", "ada of atlanta", "ada of berlin"]


# Results before the planned end


@pytest.fixture
def planned(tmp_path: Path) -> Path:
    """A study of two participants with a frozen plan; the first participant has finished."""
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', participants="2")
    for _ in range(2):
        assert command("study", "freeze", folder).exit_code == 0
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store))
    return folder


@pytest.mark.slow
def test_early_views_of_results_are_a_deviation(planned: Path) -> None:
    out = planned / "analysis"
    assert (
        command("study", "export", planned, "--format", "csv", "--out", planned.parent / "e").exit_code == 0
    )
    assert command("analyze", planned).exit_code == 0
    shown = command("study", "check", planned).stdout
    expected = (
        f"were viewed 2 times after 1 of 2 participants by the account {find_process_user().name}, first at "
    )
    assert f"deviates from the plan: {expected}" in shown
    assert command("analyze", planned).exit_code == 0
    page = " ".join(Page(out / "report" / "index.html").text.split())
    assert page.count(expected) == 2  # in the plan's deviations, and in the section about the log
    assert "The log has 3 entries" in page
    results = json.loads((out / "results.json").read_text())
    assert expected in " ".join(each["message"] for each in results["plan"]["deviations"])
    methods = (out / "reporting" / "methods.md").read_text()
    assert expected in methods


def test_empty_log_after_a_rebuild_proves_nothing() -> None:
    empty = AccessLogSummary(entries=0, people=[], first_at=None, last_at=None, interim_looks=[])
    assert "no view of this study was logged" in render_access_log_section(empty, rebuilt_at=None)
    rebuilt = render_access_log_section(empty, rebuilt_at="2026-11-27T17:05:22+00:00")
    assert "no view of this study was logged" not in rebuilt
    assert "entries from before that are lost" in rebuilt


@pytest.mark.slow
def test_views_after_the_planned_end_are_no_deviation(planned: Path) -> None:
    with StudyStore(planned) as store:
        run_participant(store, enrol_with_consent(store))
        add_log_entry(store, ADA, "view results", shows_results=True)
        (entry,) = (each for each in store.read_audit_log() if each.action == "view results")
        assert (entry.completed, entry.planned) == (2, 2)
        assert interim(store) == []
        before = analyse_study(store).access_log.entries
        add_log_entry(store, ADA, "analyze", shows_results=True)
        assert analyse_study(store).access_log.entries == before


def test_views_without_results_are_no_deviation(store: StudyStore) -> None:
    enrol_with_consent(store)
    add_log_entry(store, ADA, "analyze", shows_results=True)
    assert [(each.completed, each.planned) for each in store.read_audit_log()] == [(None, None)]
    assert interim(store) == []


def test_simulated_participants_do_not_count_with_people(store: StudyStore) -> None:
    run_participant(store, enrol_with_consent(store))
    run_participant(store, enrol_with_consent(store, simulated=False), trials=3, simulated=False)
    add_log_entry(store, ADA, "view results", shows_results=True)
    (found,) = interim(store)
    assert "after 0 of 8 participants by ada at " in found


def interim(store: StudyStore) -> list[str]:
    frozen = read_frozen_plan_evidence(store)
    if frozen is not None:
        listed = [each.message for each in find_deviations(store, frozen, {}) if "viewed" in each.message]
        assert listed == [each.message for each in check_study(store) if "viewed" in each.message]
    return [each.message for each in check_study(store) if "viewed" in each.message]


@pytest.mark.slow
def test_dashboard_shows_results_only_on_request(
    store: StudyStore, served: tuple[LiveServer[Session], str], tmp_path: Path
) -> None:
    server, token = served
    run_participant(store, enrol_with_consent(store))
    assert "results" not in ask(server, token, "/overview").json()
    assert interim(store) == []
    assert ask(server, token, "/results").json()["results"]
    (found,) = interim(store)
    assert "after 1 of 8 participants by ada at " in found
    assert found.endswith(": view results")
    path = tmp_path / "report" / "index.html"
    path.parent.mkdir()
    write_report(path, analyse_study(store), [], "..")
    assert found in " ".join(Page(path).text.split())


@pytest.mark.slow
def test_rejected_enrolment_is_logged(store: StudyStore, served: tuple[LiveServer[Session], str]) -> None:
    """A rejection reveals whether a person with that name takes part."""
    server, token = served
    new = {"sex": "woman", "name": NAME, "contact": "grace@example.org"}
    assert [ask(server, token, "/participants", new).status_code for _ in range(2)] == [200, 409]
    assert told(store.read_audit_log()) == [
        ("ada", PERSONAL_TOKEN_METHOD, "enrol", 1, ""),
        ("ada", PERSONAL_TOKEN_METHOD, "enrol", None, REJECTED_COMMAND_DETAIL),
    ]
