"""The page of somebody who has no headset, in a real browser: what they see, read and press."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from avrgym.vr.emulation.headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.server import LiveServer
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.session import Session
from journey import PATIENCE_S, await_that
from visit import ENVIRONMENT, driving

pytestmark = pytest.mark.usefixtures("unhurried")

ENDLESS = 100_000


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
                return Session(whole, driving(whole), tmp_path, send, "flat", **how)

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
    page.set_default_timeout(1000 * PATIENCE_S)
    page.goto(url.replace("#", "?detail=light#"))
    return page


@pytest.mark.slow
def test_a_press_stops_the_robot_and_nobody_speaks_of_triggers(
    sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    observed: list[events.SessionEvent] = []
    server = sessions(observed.append, trial_steps=ENDLESS)
    page = opened_page(browser, server.url)
    play(page, server)
    page.get_by_role("button", name="Stop the robot").dispatch_event("pointerdown")
    await_that(lambda: server.session.phase == "paused")
    page.get_by_text("Choose Go on to repeat the trial").wait_for()
    assert page.get_by_role("button", name="Stop the robot").count() == 0
    assert [event.by for event in observed if isinstance(event, events.Stopped)] == ["participant"]


def play(page: Page, server: LiveServer) -> None:
    """Take part without a headset until the robot moves."""
    assert page.get_by_role("main").count() == page.get_by_role("region", name="The scene").count() == 1
    page.get_by_role("button", name="Play without a headset").click()
    page.get_by_text("Then choose Go on").wait_for()
    while server.session.phase in ("calibration", "loading", "check"):
        if page.get_by_role("button", name="Go on").is_visible():
            page.keyboard.press("Enter")
        page.wait_for_timeout(300.0)
    await_that(lambda: server.session.phase == "trial")
    assert "trigger" not in page.inner_text("body").lower()
