"""The page without a headset, in a real browser: texts, display and controls."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.session import Session
from helpers.browser.accessibility import violations
from helpers.browser.journey import SEATING, TIMEOUT_S, wait_until
from helpers.vr.visit import ENVIRONMENT, constant_policies

pytestmark = pytest.mark.usefixtures("relaxed_limits")

ENDLESS = 100_000
QUESTIONS = (LIKERT_ITEMS[0], Item("line", "How hard was it?", points=21, low="very low", high="very high"))
SIZES = [(390, 844), (1280, 720)]
"""A phone's and a computer's, pixels."""


@pytest.fixture
def sessions(tmp_path: Path) -> Iterator[Callable[..., LiveServer]]:
    """Serves sessions of one trial of a plan; ``observed`` hears what happens."""
    with ExitStack() as opened:
        workers = opened.enter_context(ThreadPoolExecutor(1))

        def serve(observed: Callable[[events.SessionEvent], None] = lambda event: None, **plan) -> LiveServer:
            trial = TrialPlan(ENVIRONMENT, "drive", seed=3, practice=False)
            whole = SessionPlan([trial], "woman", 0.3, simulated=True, countdown_s=0.3, **plan)

            def make(send) -> Session:
                how = {"observe": observed, "workers": workers}
                return Session(whole, constant_policies(whole), tmp_path, send, "flat", **how)

            return opened.enter_context(LiveServer(make, "127.0.0.1", 0))

        yield serve


@pytest.fixture
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_chromium(), args=list(CHROMIUM_FLAGS))
        yield browser
        browser.close()


def opened_page(browser: Browser, url: str, width: int = 390, height: int = 844) -> Page:
    """A page with little detail, of a phone's size unless another is said."""
    page = browser.new_page(viewport={"width": width, "height": height})
    page.set_default_timeout(1000 * TIMEOUT_S)
    page.goto(url.replace("#", "?detail=light#"))
    return page


@pytest.mark.slow
def test_the_stop_button_works_and_texts_mention_no_triggers(
    sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    observed: list[events.SessionEvent] = []
    server = sessions(observed.append, trial_steps=ENDLESS)
    page = opened_page(browser, server.url)
    play(page, server)
    page.get_by_role("button", name="Stop the robot").dispatch_event("pointerdown")
    wait_until(lambda: server.session.phase == "paused")
    page.get_by_text("Choose Go on to repeat the trial").wait_for()
    assert page.get_by_role("button", name="Stop the robot").count() == 0
    assert [event.by for event in observed if isinstance(event, events.Stopped)] == ["participant"]


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_axe_finds_no_violations_during_trials(
    size: tuple[int, int], sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    server = sessions(trial_steps=ENDLESS)
    page = opened_page(browser, server.url, *size)
    page.get_by_role("button", name="Play without a headset").wait_for()
    found = {"waiting": violations(page)}
    play(page, server)
    stop = page.get_by_role("button", name="Stop the robot")
    stop.wait_for()
    found["trial"] = violations(page)
    stop.dispatch_event("pointerdown")
    page.get_by_text("Choose Go on to repeat the trial").wait_for()
    found["paused"] = violations(page)
    page.close()
    for role, token in (("experimenter", server.tokens.experimenter), ("spectator", server.tokens.spectator)):
        watching = opened_page(browser, server.urls("spectator", token)[0], *size)
        watching.get_by_role("main").wait_for()
        found[role] = violations(watching)
        watching.close()
    assert found == {state: [] for state in found}


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_axe_finds_no_violations_in_questionnaires(
    size: tuple[int, int], sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    server = sessions(trial_steps=5, items=QUESTIONS)
    page = opened_page(browser, server.url, *size)
    play(page, server)
    page.get_by_text(QUESTIONS[0].text).wait_for()
    found = {"buttons": violations(page)}
    page.keyboard.press("7")
    page.get_by_text(QUESTIONS[1].text).wait_for()
    found["line"] = violations(page)
    page.keyboard.press("End")
    page.get_by_role("button", name="Take this answer").click()
    page.get_by_role("button", name="Done").wait_for()
    found["confirm"] = violations(page)
    page.get_by_role("button", name="Done").click()
    page.get_by_text("That was all").wait_for()
    found["finished"] = violations(page)
    assert found == {state: [] for state in found}


def play(page: Page, server: LiveServer) -> None:
    """Take part without a headset, until measured and seated."""
    assert page.get_by_role("main").count() == page.get_by_role("region", name="The scene").count() == 1
    page.get_by_role("button", name="Play without a headset").click()
    page.get_by_text("Then choose Go on").wait_for()
    while server.session.phase in SEATING:
        if page.get_by_role("button", name="Go on").is_visible():
            page.keyboard.press("Enter")
        page.wait_for_timeout(300.0)
    assert "trigger" not in page.inner_text("body").lower()
