"""Every page in a real browser under its own security policy: it works without errors of the browser."""

import json
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, Playwright, expect, sync_playwright
from test_replay_shown import nothing, recording  # noqa: F401

from avrgym.replay.server import ReplayServer
from avrgym.replay.timeline import build_timeline
from avrgym.study.dashboard.application import make_dashboard_app
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session.session import Session
from helpers.browser.accessibility import violations
from helpers.studies.small_studies import make_study
from helpers.vr.visit import constant_policies, plan

PATIENCE_MS = 90_000.0
PLAN = plan()
LOSE_THE_PICTURE = """() => {
    const drawing = document.querySelector("#view canvas").getContext("webgl2");
    drawing.getExtension("WEBGL_lose_context").loseContext();
}"""


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as playwright:
        yield playwright


def launch(playwright: Playwright, *flags: str) -> Browser:
    return playwright.chromium.launch(executable_path=find_chromium(), args=[*CHROMIUM_FLAGS, *flags])


@pytest.fixture
def browser(playwright: Playwright) -> Iterator[Browser]:
    """One for each test: what one page asks of the process that draws keeps no other waiting."""
    with launch(playwright) as browser:
        yield browser


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer[Session]]:
    folder = tmp_path_factory.mktemp("served")
    study = make_study(folder / "study", tasks='["Feeding"]', title=json.dumps("A study"))
    with (
        StudyStore(study) as store,
        LiveServer(
            lambda send: Session(PLAN, constant_policies(PLAN), folder, send, "test"),
            "127.0.0.1",
            0,
            study=lambda tokens, _session: make_dashboard_app(store, tokens),
        ) as server,
    ):
        yield server


@contextmanager
def visited(browser: Browser, url: str) -> Iterator[Page]:
    """A page at an address; at its end the browser has reported no error, no refusal and no warning of its policy."""
    page = browser.new_page(viewport={"width": 480, "height": 320})
    page.set_default_timeout(PATIENCE_MS)
    said: list[str] = []
    page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: said.append(f"error: {error}"))
    page.on("requestfailed", lambda failed: said.append(f"error: {failed.url} {failed.failure}"))
    try:
        page.goto(url)
        yield page
        page.close()
    finally:
        complaints = [words for words in said if words.startswith("error") or "policy" in words.lower()]
        assert not complaints


@pytest.mark.slow
def test_the_participants_page_connects_draws_and_enters_vr(
    browser: Browser, server: LiveServer[Session]
) -> None:
    with visited(browser, server.participant_url.replace("/#", "/?emulate=1#")) as page:
        page.get_by_role("button", name="Enter VR").click()
        page.wait_for_function("() => window.avrgymEmulator?.presenting()")
        page.wait_for_function("() => window.avrgymEmulator.phase()?.name === 'calibration'")
        page.wait_for_function("() => window.avrgymEmulator.lastState() !== null")


@pytest.mark.slow
def test_the_page_draws_every_detail_without_a_headset(browser: Browser, server: LiveServer[Session]) -> None:
    """When the graphics fail, the participant stays in the scene and reads why the picture is lost."""
    with visited(browser, server.participant_url) as page:
        expect(page.locator("#status-words")).to_have_text("Connected to the server", timeout=PATIENCE_MS)
        page.get_by_role("button", name="Play without a headset").click()
        expect(page.locator("#phase-text")).not_to_be_empty(timeout=PATIENCE_MS)
        page.wait_for_load_state("networkidle")
        page.evaluate(LOSE_THE_PICTURE)
        expect(page.locator("#problem")).to_contain_text("The picture was lost")
        expect(page.locator("#play")).to_have_text("Leave the scene")


@pytest.mark.slow
@pytest.mark.parametrize("role", ["experimenter", "spectator"])
def test_the_watchers_page_shows_the_session(
    browser: Browser, server: LiveServer[Session], role: str
) -> None:
    address = server.list_page_urls("spectator", getattr(server.tokens, role))[0].replace(
        "#", "?detail=light#"
    )
    with visited(browser, address) as page:
        expect(page.locator("#watch-phase")).not_to_have_text("–", timeout=PATIENCE_MS)
        page.wait_for_load_state("networkidle")


@pytest.mark.slow
def test_the_dashboard_shows_study_and_picture(browser: Browser, server: LiveServer[Session]) -> None:
    with visited(browser, server.list_page_urls("dashboard", server.tokens.experimenter)[0]) as page:
        expect(page.locator("#title")).to_have_text("A study", timeout=PATIENCE_MS)
        inside = page.frame_locator("iframe")
        expect(inside.locator("#view canvas")).to_be_visible(timeout=PATIENCE_MS)
        assert violations(page) == []


@pytest.mark.slow
def test_the_replay_is_shown(browser: Browser, recording) -> None:  # noqa: F811
    with (
        ReplayServer(recording, *build_timeline(recording, nothing), port=0) as server,
        visited(browser, server.url.replace("#", "?detail=light#")) as page,
    ):
        page.get_by_role("button", name="Play").click()
        expect(page.locator("#step td")).not_to_have_text("–", timeout=PATIENCE_MS)
        page.wait_for_load_state("networkidle")


@pytest.mark.slow
@pytest.mark.parametrize("page_name", ["", "spectator"])
def test_a_page_that_cannot_draw_says_so(
    playwright: Playwright, server: LiveServer[Session], page_name: str
) -> None:
    with launch(playwright, "--disable-3d-apis") as browser:
        page = browser.new_page()
        page.goto(server.list_page_urls(page_name, server.tokens.experimenter)[0])
        expect(page.locator("#problem")).to_contain_text("cannot draw in 3D")
        expect(page.locator("#enter")).to_be_hidden()


@pytest.mark.slow
def test_a_page_of_another_origin_shows_none_of_ours(browser: Browser, server: LiveServer[Session]) -> None:
    """What a foreign page frames stays empty, the spectator's page as well."""
    page = browser.new_page()
    for framed in ("", "spectator", "dashboard"):
        url = f"http://127.0.0.1:{server.port}/{framed}"
        page.goto("data:text/html,<iframe></iframe>")
        page.evaluate("url => { document.querySelector('iframe').src = url }", url)
        page.wait_for_timeout(300)
        assert not any(frame.url.startswith(url) and frame.title() for frame in page.frames)
    page.close()
