"""Caregivers: own link and page, commands to the robot, and their own questions."""

import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from playwright.sync_api import expect, sync_playwright
from websockets.sync.client import ClientConnection, connect

from avrgym.analysis.report import write_report
from avrgym.analysis.study_analysis import analyse_study
from avrgym.commands.respondents import CAREGIVER_RESPONDENT
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.people.experimenters import ExperimenterTokens
from avrgym.study.sessions.stored_session_links import load_session_links
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage import database
from avrgym.study.storage.answers import find_answer_moments
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import ExperimenterCommand, Hello, OtherPersonRobotCommand, Problem, Welcome
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.session import events
from helpers.browser.accessibility import violations
from helpers.studies.small_studies import enrol_with_consent, make_study
from helpers.vr.visit import Visit, plan

PATIENCE_S = 200.0
ENDLESS = 100_000
"""Control steps of a trial that only a stop ends, also on a busy machine."""
QUESTIONS = """\
[[questionnaires]]
name = "caregiver"
when = "caregiver"
items = [
    { id = "eases", text = "The robot would ease my work.", points = 5, low = "no", high = "yes" },
    { id = "safe", text = "I would leave the room.", points = 3, low = "", high = "", labels = ["no", "so", "yes"] },
]

[goals]"""
CONDITION = """
[conditions.paced]
policy = "revised"
commands = ["ready", "slower", "stop"]
sources = ["caregiver"]
"""


@dataclass(frozen=True)
class Served:
    store: StudyStore
    server: LiveServer[StudySessions]

    @property
    def link(self) -> str:
        assert self.server.session.caregiver_links.current_link_token is not None
        return self.server.session.caregiver_links.current_link_token

    def request(self, method: str, path: str, token: str, body: Any = None) -> httpx.Response:
        headers = {"authorization": f"Bearer {token}"}
        url = f"http://127.0.0.1:{self.server.port}/study{path}"
        return httpx.request(method, url, headers=headers, timeout=PATIENCE_S, json=body)

    @contextmanager
    def watching(self, token: str) -> Iterator[ClientConnection]:
        with connect(f"ws://127.0.0.1:{self.server.port}/watch", max_size=None) as socket:
            socket.send(
                messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True))
            )
            yield socket


def received(socket: ClientConnection, kind: type, wanted: Callable[[Any], bool] = lambda _: True) -> Any:
    """The next message of a type."""
    ends_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < ends_s:
        message = messages.decode_server_message(bytes(socket.recv(PATIENCE_S)))  # type: ignore[arg-type]
        if isinstance(message, kind) and wanted(message):
            return message
    raise AssertionError(f"no {kind.__name__}")


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    policies = {
        "policies": '["paced"]',
        "practice_policy": '""',
        "free_movement_s": "0.1",
        "trial_steps": str(ENDLESS),
    }
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', **policies)
    design = folder / "study.toml"
    design.write_text(design.read_text().replace("[goals]", QUESTIONS, 1) + CONDITION)
    caregiver_links = SessionLinks()
    with (
        StudyStore(folder) as store,
        ThreadPoolExecutor(1) as workers,
        ExperimenterTokens(store) as experimenters,
    ):
        links = load_session_links(store)
        with LiveServer(
            lambda send: StudySessions(store, send, workers, links=links, caregiver_links=caregiver_links),
            "127.0.0.1",
            0,
            study=lambda tokens, sessions: make_dashboard_app(store, tokens, sessions),
            tokens=StudyTokens.load_for_study(
                tmp_path / "tokens.json", experimenters, links, caregiver_links
            ),
            links=links,
        ) as server:
            server.session.begin_session(enrol_with_consent(store))
            yield Served(store, server)


def test_a_caregiver_watches_and_answers_with_their_own_link(served: Served, tmp_path: Path) -> None:
    """The link opens neither the dashboard nor the participant's place. It ends when the next session begins."""
    token, sessions = served.link, served.server.session
    with served.watching(token) as socket:
        assert received(socket, Welcome).role == CAREGIVER_RESPONDENT
        socket.send(messages.encode_message(ExperimenterCommand("end")))
        assert (
            received(socket, Problem).message
            == "caregivers may send only robot commands; open the experimenter's address"
        )
        socket.send(messages.encode_message(OtherPersonRobotCommand("stop", "experimenter", 0.0)))
        assert "the source of commands from this page must be caregiver" in received(socket, Problem).message
    assert served.request("GET", "/overview", token).status_code == 401
    assert (
        served.request("GET", "/care/items", sessions.participant_links.current_link_token or "").status_code
        == 401
    )
    items = served.request("GET", "/care/items", token).json()
    assert [(each["id"], each["answer"]) for each in items] == [("eases", None), ("safe", None)]

    def answer(item: str, value: int) -> int:
        body = {"item": item, "value": value, "response_time_s": 2.0}
        return served.request("POST", "/care/answers", token, body).status_code

    assert (answer("eases", 9), answer("L1", 3), answer("eases", 4), answer("eases", 5)) == (
        409,
        409,
        204,
        204,
    )
    (participant,) = served.store.read_participants()
    with served.watching(served.server.tokens.experimenter) as socket:
        socket.send(messages.encode_message(ExperimenterCommand("end")))
        received(socket, messages.PhaseDescription, lambda phase: phase.name == "finished")
    while sessions.running_participant is not None:
        time.sleep(0.05)
    assert answer("safe", 3) == 204  # after the session
    given = served.store.read_answers(participant.pseudonym)
    assert [(each.item, each.value, each.respondent) for each in given] == [
        ("eases", 5, CAREGIVER_RESPONDENT),
        ("safe", 3, CAREGIVER_RESPONDENT),
    ]
    moments = find_answer_moments(served.store.design, given, served.store.read_events())
    assert set(moments.values()) == {CAREGIVER_RESPONDENT}
    analysis = analyse_study(served.store)
    rows = analysis.study_data.answers
    summaries = [(row.item, row.moment, row.n, row.mean) for row in analysis.session_answers]
    assert summaries == [("eases", CAREGIVER_RESPONDENT, 1, 5.0), ("safe", CAREGIVER_RESPONDENT, 1, 3.0)]
    write_report(tmp_path / "report.html", analysis, [], "")
    assert "caregiver, answered by caregivers for themselves" in (tmp_path / "report.html").read_text()
    assert [(row.respondent, row.moment, row.counted) for row in rows] == [
        (CAREGIVER_RESPONDENT, CAREGIVER_RESPONDENT, True)
    ] * 2
    sessions.begin_session(participant.pseudonym)
    assert served.link != token
    assert answer("safe", 1) == 401


def test_a_caregiver_stops_the_robot(tmp_path: Path) -> None:
    """The stop works although no condition allows commands of caregivers; another command is ignored."""
    visit = Visit(tmp_path, plan())
    visit.go_to("trial")
    visit.send(OtherPersonRobotCommand("slower", "caregiver", 0.0))
    assert visit.phase == "trial"
    visit.send(OtherPersonRobotCommand("stop", "caregiver", 0.0))
    assert visit.phase == "paused"
    stopped = [each for each in visit.observed if isinstance(each, events.Stopped)]
    ignored = [each for each in visit.observed if isinstance(each, events.CommandIgnored)]
    assert [each.by for each in stopped] == ["caregiver"]
    assert [(each.name, each.source) for each in ignored] == [("slower", "caregiver")]
    visit.leave()


@pytest.mark.slow
def test_the_page_of_the_caregiver_in_a_browser(served: Served, tmp_path: Path) -> None:
    """The page shows the scene, stores answers, and has no accessibility violations."""
    expect.set_options(timeout=1000 * PATIENCE_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=CHROMIUM_FLAGS)
        page = browser.new_page(viewport={"width": 800, "height": 600})
        page.set_default_timeout(1000 * PATIENCE_S)
        page.goto(f"http://localhost:{served.server.port}/caregiver?detail=light#token={served.link}")
        expect(page.locator("#server")).to_have_text("Connected to the server")
        expect(page.locator("iframe")).to_be_visible()
        page.get_by_role("group", name="I would leave the room.").get_by_label("so").check()
        expect(page.locator("#answered")).to_have_text("Your answer is stored.")
        assert violations(page) == []
        page.screenshot(path=tmp_path / "caregiver.png", full_page=True)
        page.reload()
        field = page.get_by_role("group", name="I would leave the room.")
        expect(field.get_by_label("so")).to_be_checked()
        browser.close()
    (participant,) = served.store.read_participants()
    (given,) = served.store.read_answers(participant.pseudonym)
    assert (given.item, given.value, given.respondent) == ("safe", 2, CAREGIVER_RESPONDENT)


@pytest.mark.slow
@pytest.mark.usefixtures("relaxed_limits")
def test_a_caregiver_takes_part_in_a_trial_in_a_browser(served: Served) -> None:
    """The participant plays without a headset. The caregiver sees the trial, commands, stops the robot and answers."""
    expect.set_options(timeout=1000 * PATIENCE_S)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=CHROMIUM_FLAGS)
        address = f"http://localhost:{served.server.port}"
        care, participant = browser.new_page(), browser.new_page(viewport={"width": 480, "height": 480})
        for page in (care, participant):
            page.set_default_timeout(1000 * PATIENCE_S)
        care.goto(f"{address}/caregiver?detail=light#token={served.link}")
        commands = care.get_by_role("group", name="Commands to the robot")
        expect(care.locator("#phase")).not_to_be_empty()
        expect(commands).to_be_hidden()
        participant.goto(
            f"{address}/?detail=light#token={served.server.session.participant_links.current_link_token}"
        )
        participant.get_by_role("button", name="Play without a headset").click()
        go_on = participant.get_by_role("button", name="Go on")
        while commands.is_hidden():
            if go_on.is_visible():  # the next phase may hide the button before a real click
                participant.locator("#ready").dispatch_event("click")
            participant.wait_for_timeout(300.0)
        assert violations(care) == []
        expect(commands.get_by_role("button")).to_have_count(3)
        commands.get_by_role("button", name="Slower").click()
        care.get_by_role("button", name="Stop the robot").click()
        expect(participant.get_by_text("Choose Go on to repeat the trial")).to_be_visible()
        expect(commands).to_be_hidden()
        care.get_by_role("group", name="The robot would ease my work.").get_by_label("4").check()
        expect(care.locator("#answered")).to_have_text("Your answer is stored.")
        browser.close()
    names = [(event.name, event.detail) for event in served.store.read_events()]
    given = [detail for name, detail in names if name == "robot commanded"]
    assert given == ["name slower, source caregiver", "name stop, source caregiver"]
    assert [detail.partition(",")[0] for name, detail in names if name == "stopped"] == ["by caregiver"]
    (participant_row,) = served.store.read_participants()
    (answer,) = served.store.read_answers(participant_row.pseudonym)
    assert (answer.item, answer.value, answer.respondent) == ("eases", 4, CAREGIVER_RESPONDENT)
