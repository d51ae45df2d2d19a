"""Links of participants: each opens one session and ends with it; codes are valid for minutes."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from playwright.sync_api import Page, expect, sync_playwright
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.people.experimenters import ExperimenterTokens
from avrgym.study.people.participants import enrol_participant, record_consent, record_inclusion_answers
from avrgym.study.sessions.stored_session_links import load_session_links
from avrgym.study.sessions.study_sessions import StudySessions
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.texts.interface_texts import read_texts
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import Hello, Language, Message, Problem, Welcome
from avrgym.vr.server import session_links as links_module
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.server.session_links import (
    CODE_VALIDITY_S,
    MAX_WRONG_CODES,
    WRONG_CODE_WINDOW_S,
    CodeError,
    SessionLinks,
    TooManyWrongCodesError,
    compute_token_sha256,
    generate_link_token,
)
from helpers.studies.small_studies import eligible_answers, enrol_with_consent, make_study
from helpers.vr.received_states import decode_message

PATIENCE_S = 120.0
GERMAN = read_texts("de").page
ENGLISH = Language("en", "ltr", {})


@dataclass(frozen=True)
class Served:
    """A study server like that of ``avrgym serve``."""

    store: StudyStore
    server: LiveServer[StudySessions]

    @property
    def sessions(self) -> StudySessions:
        return self.server.session

    @property
    def link(self) -> str:
        """The link of the running session."""
        assert self.sessions.participant_links.current_link_token is not None
        return self.sessions.participant_links.current_link_token

    def request(self, method: str, path: str, token: str, **options: Any) -> httpx.Response:
        headers = {"authorization": f"Bearer {token}"}
        url = f"http://127.0.0.1:{self.server.port}{path}"
        return httpx.request(method, url, headers=headers, timeout=PATIENCE_S, **options)


@contextmanager
def serving(store: StudyStore, folder: Path) -> Iterator[Served]:
    links = load_session_links(store)
    with (
        ThreadPoolExecutor(1) as workers,
        ExperimenterTokens(store) as experimenters,
        LiveServer(
            lambda send: StudySessions(store, send, workers, links=links),
            "127.0.0.1",
            0,
            study=lambda tokens, sessions: make_dashboard_app(store, tokens, sessions),
            tokens=StudyTokens.load_for_study(folder / "tokens.json", experimenters, links),
            links=links,
        ) as server,
    ):
        yield Served(store, server)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[StudyStore]:
    folder = make_study(tmp_path / "study", tasks='["Feeding"]', robots='["Jaco"]', languages='["en", "de"]')
    with StudyStore(folder) as opened:
        yield opened


@pytest.fixture
def served(store: StudyStore, tmp_path: Path) -> Iterator[Served]:
    with serving(store, tmp_path) as opened:
        yield opened


def take_in_german(store: StudyStore) -> str:
    pseudonym = enrol_participant(store, "man", language="de")
    record_consent(store, pseudonym)
    record_inclusion_answers(store, pseudonym, eligible_answers(store))
    return pseudonym


@contextmanager
def opened(served: Served, token: str, path: str = "/ws") -> Iterator[ClientConnection]:
    """A connected socket."""
    with connect(f"ws://127.0.0.1:{served.server.port}{path}", max_size=None) as socket:
        socket.send(messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True)))
        yield socket


def first(socket: ClientConnection) -> Message:
    message = decode_message(socket, socket.recv(PATIENCE_S))
    assert message is not None
    return message


def identifier(served: Served, link: str) -> str:
    """The identifier of the session that a link opens."""
    with opened(served, link) as socket:
        welcome = first(socket)
        assert isinstance(welcome, Welcome), welcome
        return welcome.session


def closing(socket: ClientConnection) -> int | None:
    """Receive all messages and return the close code of the connection."""
    rest(socket)
    return socket.close_code


def rest(socket: ClientConnection) -> list[Message]:
    """All remaining messages."""
    heard: list[Message] = []
    with suppress(ConnectionClosed):
        while True:
            heard.append(first(socket))
    return heard


def refused(served: Served, token: str, path: str = "/ws") -> tuple[int | None, str | None]:
    """Status code and language of a rejection."""
    with opened(served, token, path) as socket:
        message = first(socket)
        language = message.language if isinstance(message, Language) else None
        if language is not None:
            message = first(socket)
        assert isinstance(message, Problem), message
        return closing(socket), language


# One session, one link ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_link_opens_one_session(served: Served) -> None:
    german, other = take_in_german(served.store), enrol_with_consent(served.store)
    served.sessions.begin_session(german)
    link = served.link
    assert identifier(served, link) == f"{german} ses-01"
    assert identifier(served, link) == f"{german} ses-01", "a page that is loaded again"
    with opened(served, link) as connected:
        assert isinstance(first(connected), Welcome)
        served.sessions.withdraw_participant(german, "")
        assert closing(connected) == 4410
    assert refused(served, link) == (4410, "de")
    served.sessions.begin_session(other)
    assert served.link != link
    assert refused(served, link) == (4410, "de")
    assert identifier(served, served.link) == f"{other} ses-01"


def test_connected_client_receives_nothing_of_the_next_session(served: Served) -> None:
    pseudonym, other = enrol_with_consent(served.store), enrol_with_consent(served.store)
    served.sessions.begin_session(pseudonym)
    with opened(served, served.link) as connected:
        assert isinstance(first(connected), Welcome)
        served.sessions.withdraw_participant(pseudonym, "")
        served.sessions.begin_session(other)
        heard = rest(connected)
        assert connected.close_code == 4410
    assert not [each for each in heard if isinstance(each, Welcome)]


def test_address_without_a_link_opens_no_session(served: Served) -> None:
    pseudonym = enrol_with_consent(served.store)
    assert refused(served, served.server.tokens.participant) == (4403, None)
    served.sessions.begin_session(pseudonym)
    assert refused(served, served.server.tokens.participant) == (4403, None)
    assert served.request("GET", "/scenes/0.glb", served.server.tokens.participant).status_code == 401
    assert refused(served, "") == (4411, None)
    assert refused(served, generate_link_token()) == (4403, None)


def test_link_gives_no_access_to_the_dashboard(served: Served) -> None:
    served.sessions.begin_session(enrol_with_consent(served.store))
    assert refused(served, served.link, "/watch")[0] == 4403
    for method, path in (("GET", "/study/overview"), ("POST", "/study/participants")):
        assert served.request(method, path, served.link).status_code == 401


def test_new_link_ends_the_earlier_one(served: Served) -> None:
    pseudonym = enrol_with_consent(served.store)
    served.sessions.begin_session(pseudonym)
    link = served.link
    with opened(served, link) as connected:
        assert isinstance(first(connected), Welcome)
        path = f"/study/participants/{pseudonym}/links"
        made = served.request("POST", path, served.server.tokens.experimenter, json={})
        assert made.status_code == 204
        assert closing(connected) == 4410
    assert refused(served, link) == (4410, "en")
    assert identifier(served, served.link) == f"{pseudonym} ses-01"
    with pytest.raises(StudyError, match="no session of sub-999 is running"):
        served.sessions.renew_session_link("sub-999")


@pytest.mark.slow
def test_only_checksums_of_links_are_stored(store: StudyStore, tmp_path: Path) -> None:
    german = take_in_german(store)
    with serving(store, tmp_path) as served:
        served.sessions.begin_session(german)
        link = served.link
        assert len(link) >= 22
    files = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert not any(link.encode() in data for data in files)
    assert any(compute_token_sha256(link).encode() in data for data in files)
    with serving(store, tmp_path) as served:
        served.sessions.begin_session(german)
        assert refused(served, link) == (4410, "de")
        assert identifier(served, served.link) == f"{german} ses-02"


# Codes -------------------------------------------------------------------------------------------------------


class Clock:
    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now_s = 1000.0
        monkeypatch.setattr(links_module, "time", SimpleNamespace(monotonic=lambda: self.now_s))


def test_code_is_valid_once_and_for_minutes(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, links = Clock(monkeypatch), SessionLinks()
    assert links.get_or_create_code() is None
    links.set_link_token("first", ENGLISH)
    code = links.get_or_create_code()
    assert code is not None
    assert (len(code), links.get_or_create_code()) == (6, code)
    assert links.exchange_code(code) == "first"
    with pytest.raises(CodeError):
        links.exchange_code(code)
    later = links.get_or_create_code()
    assert later is not None
    clock.now_s += CODE_VALIDITY_S - 1.0
    assert links.get_or_create_code() != later
    assert links.exchange_code(later) == "first"
    old = links.get_or_create_code()
    assert old is not None
    clock.now_s += CODE_VALIDITY_S + 1.0
    with pytest.raises(CodeError):
        links.exchange_code(old)
    last = links.get_or_create_code()
    assert last is not None
    links.set_link_token("second", ENGLISH)
    with pytest.raises(CodeError):
        links.exchange_code(last)


def test_number_of_guesses_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    clock, links = Clock(monkeypatch), SessionLinks()
    links.set_link_token("link", ENGLISH)
    code = links.get_or_create_code()
    assert code is not None
    wrong = f"{(int(code) + 1) % 10**6:06}"
    for _ in range(MAX_WRONG_CODES):
        with pytest.raises(CodeError):
            links.exchange_code(wrong)
    for guess in (wrong, code):
        with pytest.raises(TooManyWrongCodesError):
            links.exchange_code(guess)
    clock.now_s += WRONG_CODE_WINDOW_S + 1.0
    assert links.exchange_code(code) == "link"


@pytest.mark.slow
def test_page_exchanges_a_code_for_the_link(served: Served) -> None:
    assert served.request("POST", "/link", "nobody", json={"code": "000000"}).status_code == 403
    pseudonym = enrol_with_consent(served.store)
    served.sessions.begin_session(pseudonym)
    shown = served.request("GET", "/study/overview", served.server.tokens.experimenter).json()["link"]
    assert shown["addresses"] == [f"/#token={served.link}"]
    code = shown["code"]
    answer = served.request("POST", "/link", "nobody", json={"code": f"{code[:3]} {code[3:]}"})
    assert (answer.status_code, answer.json()) == (200, {"token": served.link})
    assert served.request("POST", "/link", "nobody", json={"code": code}).status_code == 403
    for body, status in (({"code": 1}, 422), ({}, 422), ({"code": "1" * 2000}, 413)):
        assert served.request("POST", "/link", "nobody", json=body).status_code == status
    assert served.request("POST", "/link", "nobody", content=b"{}").status_code == 415
    url = f"http://127.0.0.1:{served.server.port}/link"
    assert httpx.post(url, json={"code": code}, headers={"origin": "http://evil.test"}).status_code == 403
    for _ in range(MAX_WRONG_CODES):
        served.request("POST", "/link", "nobody", json={"code": "x"})
    assert served.request("POST", "/link", "nobody", json={"code": "x"}).status_code == 429


# In the browser ----------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_headset_joins_by_code(served: Served) -> None:
    expect.set_options(timeout=1000 * PATIENCE_S)
    german, other = take_in_german(served.store), enrol_with_consent(served.store)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page(viewport={"width": 640, "height": 480}, locale="en")
        page.set_default_timeout(1000 * PATIENCE_S)
        dashboard = browser.new_page(viewport={"width": 900, "height": 900})
        experimenter = served.server.tokens.experimenter
        dashboard.goto(served.server.list_page_urls("dashboard?detail=light", experimenter)[0])
        dashboard.get_by_role("button", name=german).click()
        dashboard.get_by_role("button", name="Begin session").click()
        expect(dashboard.locator("#link-code")).to_contain_text(" ")
        page.goto(f"{served.server.list_participant_urls_without_token()[0]}?detail=light")
        expect(page.locator("#status-words")).to_have_text("Enter the code that the experimenter gives you.")
        enter(page, "12")
        expect(page.locator("#code-wrong")).to_contain_text("wrong or too old")
        enter(page, dashboard.locator("#link-code").inner_text())
        expect(page.locator("#status-words")).to_have_text(GERMAN["connected"])
        page.reload()
        expect(page.locator("#status-words")).to_have_text(GERMAN["connected"])
        expect(page.locator("#entrance")).to_be_hidden()

        dashboard.get_by_role("button", name="End session").click()
        expect(page.locator("#status-words")).to_have_text(GERMAN["link_ended"])
        expect(dashboard.locator("#link")).to_be_hidden()
        page.reload()
        expect(page.locator("#status-words")).to_have_text(GERMAN["link_ended"])
        expect(page.locator("#take-part")).to_be_hidden()

        served.sessions.begin_session(other)
        page.reload()
        expect(page.locator("#status-words")).to_have_text(GERMAN["link_ended"])
        enter(page, served.sessions.participant_links.get_or_create_code() or "")
        expect(page.locator("#status-words")).to_have_text("Connected to the server")
        browser.close()


def enter(page: Page, code: str) -> None:
    page.locator("#code").fill(code)
    page.locator("#code").press("Enter")
