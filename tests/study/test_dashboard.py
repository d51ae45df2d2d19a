"""The experimenter's dashboard: routes on a server, and the page in a browser."""

import json
import stat
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import httpx
import pytest
from fastapi.routing import APIRoute
from playwright.sync_api import Page, expect, sync_playwright

from avrgym.recording.input_profile import InputProfile
from avrgym.study.checking.study_summary import summarise_results
from avrgym.study.dashboard.application import MAX_REQUEST_BODY_BYTES, PARTICIPANT_ACTIONS, make_dashboard_app
from avrgym.study.people.participants import withdraw_participant
from avrgym.study.storage.identity_file import Identity, read_identities
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.authentication import AuthenticatedClient, Tokens
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.browser.accessibility import violations
from helpers.studies.small_studies import (
    METRICS,
    eligible_answers,
    enrol_with_consent,
    make_study,
    run_participant,
)
from helpers.vr.visit import constant_policies, plan

PATIENCE_S = 400.0
HOSTILE = "<script>window.hacked = 1</script><img src=x onerror='window.hacked = 2'>"
READING = ("/overview", "/results", "/participants/{pseudonym}")
ACTING = ("/participants", *(f"/participants/{{pseudonym}}/{name}" for name in PARTICIPANT_ACTIONS))
ROUTES = [*(("GET", path) for path in READING), *(("POST", path) for path in ACTING)]
BODIES: dict[str, Any] = {
    "identity": {"name": "Ada Example", "contact": "ada@example.org"},
    "consent": {"version": "1"},
    "declined-consent": {"version": "1"},
    "inclusion": {"answers": {}},
    "input": {"profile": {"method": "head", "dwell_s": 2}},
    "respondent": {"respondent": "proxy"},
    "preferences": {"changes": ["speed=0.5"]},
    "withdrawal": {"reason": ""},
    "notes": {"text": "looked left"},
    "edited-notes": {"id": 1, "text": "looked right"},
    "adverse-events": {
        "report": {
            "began_at": "2026-11-27T14:30:00Z",
            "description": "dizzy",
            "severity": "mild",
            "seriousness": "not serious",
            "relatedness": "possible",
            "outcome": "recovered",
        }
    },
    "sessions": {},
    "links": {},
}

REFUSED = "status of 409 (Conflict)"
"""What a browser logs where the server refuses an action, which the page shows in words."""

CLIENT = httpx.Client(timeout=PATIENCE_S, limits=httpx.Limits(max_keepalive_connections=0))
"""Made once, because that takes long; it keeps no connection."""


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StudyStore]:
    folder = make_study(
        tmp_path_factory.mktemp("study"),
        title=json.dumps(f"Study {HOSTILE}"),
        tasks='["Feeding"]',
        blind_experimenter="true",
    )
    with StudyStore(folder) as store:
        yield store


@pytest.fixture(scope="module")
def server(store: StudyStore, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer[Session]]:
    folder = tmp_path_factory.mktemp("recordings")
    with LiveServer(
        lambda send: Session(plan(), constant_policies(plan()), folder, send, "test"),
        "127.0.0.1",
        0,
        study=lambda tokens, _session: make_dashboard_app(store, tokens),
    ) as server:
        yield server


def ask(server: LiveServer, method: str, path: str, body: Any = None, **headers: str) -> httpx.Response:
    """A request with the experimenter's token, unless other headers are given."""
    headers = headers or {"authorization": f"Bearer {server.tokens.experimenter}"}
    url = f"http://127.0.0.1:{server.port}/study{path}"
    return CLIENT.request(method, url, headers=headers, json=body)


def post(server: LiveServer, path: str, body: Any, status: int = 204) -> Any:
    answer = ask(server, "POST", path, body)
    assert answer.status_code == status, answer.text
    return answer.json() if answer.content else None


# Who may come in ---------------------------------------------------------------------------------------------


def test_all_routes_are_tested(store: StudyStore) -> None:
    routes = make_dashboard_app(store, Tokens.generate()).routes
    found = {
        (method, route.path)
        for route in routes
        if isinstance(route, APIRoute)
        for method in route.methods or ()
    }
    assert found == set(ROUTES)
    assert all(isinstance(route, APIRoute) for route in routes)


@pytest.mark.fast_cases(10)
@pytest.mark.parametrize(("method", "path"), ROUTES)
def test_only_the_experimenter_has_access(
    server: LiveServer, store: StudyStore, method: str, path: str
) -> None:
    """Invalid tokens, origins and hosts are rejected, and nothing is stored."""
    before = store.read_events(), store.read_participants(), store.read_audit_log()
    path = path.format(pseudonym="sub-001")
    body = BODIES.get(path.rpartition("/")[2], {"sex": "man"}) if method == "POST" else None
    own, others = server.tokens.experimenter, (server.tokens.participant, server.tokens.spectator, "x")
    for token in (*(f"Bearer {other}" for other in others), own, f"Basic {own}"):
        assert ask(server, method, path, body, authorization=token).status_code == 401
    assert ask(server, method, f"{path}?token={own}", body, accept="*/*").status_code == 401
    for origin in ("http://evil.test", "null", f"http://127.0.0.1:{server.port + 1}"):
        assert (
            ask(server, method, path, body, origin=origin, authorization=f"Bearer {own}").status_code == 403
        )
    for host in ("evil.test", f"evil.test:{server.port}"):
        assert ask(server, method, path, body, host=host, authorization=f"Bearer {own}").status_code == 400
    assert (store.read_events(), store.read_participants(), store.read_audit_log()) == before


def test_page_loads_only_from_this_server(server: LiveServer) -> None:
    page = CLIENT.get(f"http://127.0.0.1:{server.port}/dashboard")
    policy = page.headers["content-security-policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';")
    assert "require-trusted-types-for 'script'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "unsafe" not in policy
    assert "://" not in page.text
    assert "cache-control" in ask(server, "GET", "/overview").headers


# What is refused ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("path", "body", "status", "words"),
    [
        ("/participants", {"sex": "x"}, 422, "sex"),
        ("/participants", {"sex": "man", "robot": 1}, 422, "robot"),
        ("/participants", {"sex": "man", "age_years": 999}, 409, "0 to 130"),
        ("/participants", {"sex": "man", "name": "n" * 201}, 422, "name"),
        ("/participants", {"sex": "man", "name": "n" * MAX_REQUEST_BODY_BYTES}, 413, "too long"),
        ("/participants/sub-999/notes", {"text": "x"}, 409, "no sub-999"),
        ("/participants/..%2f..%2fkey/notes", {"text": "x"}, 404, ""),
        ("/participants/sub-1/notes", {"text": "x"}, 409, "not a pseudonym"),
    ],
)
def test_invalid_requests_change_nothing(
    server: LiveServer, store: StudyStore, path: str, body: Any, status: int, words: str
) -> None:
    before = store.read_events(), store.read_participants()
    assert words in post(server, path, body, status)["detail"]
    assert (store.read_events(), store.read_participants()) == before


def test_only_json_is_accepted(server: LiveServer) -> None:
    """Forms of other pages cannot send valid requests."""
    url = f"http://127.0.0.1:{server.port}/study/participants"
    own = {"authorization": f"Bearer {server.tokens.experimenter}"}
    for kind in ("text/plain", "application/x-www-form-urlencoded"):
        refused = CLIENT.post(url, content=b'{"sex": "man"}', headers={**own, "content-type": kind})
        assert refused.status_code == 415


# The way of a participant ------------------------------------------------------------------------------------


def test_participant_from_enrolment_to_withdrawal(server: LiveServer, store: StudyStore) -> None:
    pseudonym = post(server, "/participants", {"sex": "woman", "age_years": 30}, 200)["participant"]
    path = f"/participants/{pseudonym}"
    assert (
        "consented" in post(server, f"{path}/inclusion", {"answers": eligible_answers(store)}, 409)["detail"]
    )
    assert "version" in post(server, f"{path}/consent", {"version": "0"}, 409)["detail"]
    post(server, f"{path}/consent", {"version": "1"})
    assert (
        "an answer is missing"
        in post(server, f"{path}/inclusion", {"answers": {"adult": True}}, 409)["detail"]
    )
    post(server, f"{path}/inclusion", {"answers": eligible_answers(store)})
    assert store.read_participant(pseudonym).state == "allocated"
    post(server, f"{path}/notes", {"text": HOSTILE})
    shown = ask(server, "GET", path).json()
    assert [note["text"] for note in shown["notes"]] == [HOSTILE]
    assert len(shown["trials"]) == 5
    assert "this server runs no sessions" in post(server, f"{path}/sessions", {}, 409)["detail"]
    post(server, f"{path}/withdrawal", {"reason": "tired"})
    assert store.read_participant(pseudonym).state == "withdrawn"
    assert "final" in post(server, f"{path}/withdrawal", {"reason": ""}, 409)["detail"]


def test_names_are_only_in_the_encrypted_identity_file(
    server: LiveServer, store: StudyStore, capfd: pytest.CaptureFixture[str]
) -> None:
    name, contact, later = "Zora Unmistakable", "zora@example.org", "Zora Corrected"
    pseudonym = post(server, "/participants", {"sex": "woman", "name": name, "contact": contact}, 200)[
        "participant"
    ]
    post(server, f"/participants/{pseudonym}/identity", {"name": later, "contact": contact})
    for wrong in ({"name": name, "contact": 1}, {"name": name}, [name]):
        refused = ask(server, "POST", f"/participants/{pseudonym}/identity", wrong)
        assert refused.status_code == 422
        assert name not in refused.text
    read = ask(server, "GET", f"/participants/{pseudonym}")
    assert read.json()["identified"]
    said = read.text + ask(server, "GET", "/overview").text + "".join(capfd.readouterr())
    assert "Zora" not in said
    assert contact not in said
    key = store.folder / "private" / "identities.json"
    assert read_identities(store.folder)[pseudonym] == Identity(later, contact)
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    held = {path.name for path in store.folder.rglob("*") if path.is_file() and b"Zora" in path.read_bytes()}
    assert held == set()


# Results and blinding ----------------------------------------------------------------------------------------


def test_results_are_means_of_completed_trials_by_condition(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path, tasks='["Feeding"]', blind_experimenter="true")) as store:
        assert summarise_results(store) == ()
        run_participant(store, enrol_with_consent(store))
        run_participant(store, enrol_with_consent(store), trials=3)
        gone = enrol_with_consent(store)
        run_participant(store, gone)
        withdraw_participant(store, gone)
        run_participant(store, enrol_with_consent(store, simulated=False), trials=2, simulated=False)
        rows = summarise_results(store)
    assert sum(row.trials for row in rows if row.simulated) == 4 + 2
    assert sum(row.trials for row in rows if not row.simulated) == 1
    for row in rows:
        assert row.policy in ("A", "B")
        assert (row.task, row.reward_mean, row.success_rate) == ("Feeding", METRICS.reward, 1.0)
        assert list(row.answer_means.values()) == [3, 4, 5, 6]


@pytest.mark.parametrize("blind", [False, True])
@pytest.mark.fast_cases(1)
def test_blinded_experimenter_sees_no_condition(tmp_path: Path, blind: bool) -> None:
    folder = make_study(tmp_path, tasks='["Feeding"]', blind_experimenter=json.dumps(blind))
    with StudyStore(folder) as store:
        pseudonym = enrol_with_consent(store)
        run_participant(store, pseudonym, trials=3)
        app = make_dashboard_app(store, Tokens.generate())
        shown = json.dumps(
            [read(app, path) for path in ("/overview", "/results", f"/participants/{pseudonym}")]
        )
    policies = {name for name in ("original", "revised") if f'"{name}"' in shown}
    assert policies == (set() if blind else {"original", "revised"})
    assert ('"A"' in shown) == blind


def read(app: Any, path: str) -> Any:
    """The response of a GET route, called directly without access control."""
    route = next(route for route in app.routes if route.path_regex.fullmatch(path) and "GET" in route.methods)
    request = SimpleNamespace(state=SimpleNamespace(caller=AuthenticatedClient("experimenter")))
    return json.loads(route.endpoint(**route.path_regex.fullmatch(path).groupdict(), request=request).body)


# In the browser ----------------------------------------------------------------------------------------------


@pytest.fixture
def page(server: LiveServer) -> Iterator[Page]:
    """The dashboard in Chromium; any error in its console fails the test."""
    complaints: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        page = browser.new_page(viewport={"width": 320, "height": 600})
        page.set_default_timeout(1000 * PATIENCE_S)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "console", lambda message: complaints.append(message.text) if message.type == "error" else None
        )
        page.goto(server.list_page_urls("dashboard?detail=light", server.tokens.experimenter)[0])
        yield page
        browser.close()
    assert [each for each in complaints if REFUSED not in each] == []


@pytest.mark.slow
def test_enrolment_by_keyboard(server: LiveServer, store: StudyStore, page: Page) -> None:
    """Enrolment, consent, inclusion and note appear in the table; text is escaped and fits a narrow page."""
    expect.set_options(timeout=1000 * PATIENCE_S)
    expect(page.locator("#server")).to_contain_text("Connected")
    number = len(store.read_participants()) + 1
    press(page, "Enrol somebody")
    page.get_by_label("Body model").press("w")
    form = page.locator("#enrol")
    expect(form.get_by_label("Dwell, s")).to_be_hidden()
    form.get_by_label("Input").press_sequentially("head")
    form.get_by_label("Dwell, s").fill("0.7")
    form.get_by_role("group", name="Amputated arms").get_by_label("left").press("Space")
    form.get_by_label("a signal to the experimenter").press("Space")
    form.get_by_label("Name").press_sequentially("Ada Example")
    page.keyboard.press("Enter")
    pseudonym = f"sub-{number:03}"
    expect(page.locator("#participant-heading")).to_be_focused()
    expect(page.locator("#participant-heading")).to_have_text(pseudonym)
    expect(page.get_by_role("row", name=pseudonym)).to_contain_text("enrolled")
    assert "Ada" not in page.content()
    chosen = InputProfile("head", dwell_s=0.7, absent_arms=("left",), stops=("gaze", "experimenter"))
    assert store.read_participant(pseudonym).input_profile == chosen
    page.evaluate("document.querySelectorAll('details').forEach((each) => (each.open = true))")
    expect(page.locator("#input").get_by_label("Dwell, s")).to_have_value("0.7")
    assert violations(page) == []

    page.get_by_label("They have read version 1 and agree").press("Space")
    page.get_by_role("button", name="Record consent").press("Enter")
    expect(page.get_by_role("row", name=pseudonym)).to_contain_text("consented")
    for question in store.design.inclusion:
        answer = "yes" if question.required else "no"
        page.get_by_role("group", name=question.text).get_by_label(answer).press("Space")
    page.get_by_role("button", name="Record answers").press("Enter")
    page.locator("body").press("n")
    expect(page.get_by_role("row", name=pseudonym)).to_contain_text("0 of 5")
    assert store.read_participant(pseudonym).state == "allocated"

    expect(page.get_by_label("New note")).to_be_focused()
    page.keyboard.insert_text(HOSTILE)
    page.get_by_role("button", name="Add note").press("Enter")
    expect(page.locator("#notes")).to_contain_text(HOSTILE)
    expect(page.locator("h1")).to_have_text(f"Study {HOSTILE}")
    assert page.evaluate("window.hacked") is None
    page.keyboard.press("Tab")
    page.keyboard.press("v")
    expect(page.frame_locator("iframe").get_by_label("participant's eyes")).to_be_checked()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert [note.text for note in store.read_notes(pseudonym)] == [HOSTILE]


def press(page: Page, summary: str) -> None:
    page.locator("summary", has_text=summary).press("Enter")


@pytest.mark.slow
def test_page_requests_confirmation_of_a_possible_duplicate(
    server: LiveServer, store: StudyStore, page: Page
) -> None:
    """The error contains only the pseudonym; the person is enrolled after confirmation."""
    expect.set_options(timeout=1000 * PATIENCE_S)
    expect(page.locator("#server")).to_contain_text("Connected")
    first = post(server, "/participants", {"sex": "woman", "name": "Grace Double"}, 200)["participant"]
    press(page, "Enrol somebody")
    form = page.locator("#enrol")
    box = form.get_by_label("This is another person")
    expect(box).to_be_hidden()
    form.get_by_label("Body model").select_option("woman")
    form.get_by_label("Name").fill("GRACE  double")
    form.get_by_label("Name").press("Enter")
    expect(page.locator("#refused")).to_contain_text(first)
    assert "Grace" not in page.locator("#refused").inner_text()
    expect(box).to_be_focused()
    box.check()
    form.get_by_role("button", name="Enrol").click()
    expect(page.locator("#done")).to_contain_text("is enrolled")
    expect(box).to_be_hidden()
    assert len(store.read_participants()) == int(first.removeprefix("sub-")) + 1
