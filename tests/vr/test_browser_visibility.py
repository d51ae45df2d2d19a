"""In a browser: a menu over VR, a removed headset, failing graphics and a page in the background hold the robot."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from playwright.sync_api import Page

from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.session import Session
from helpers.browser.journey import SEATING, Journey, wait_until
from helpers.vr.visit import constant_policies, plan

pytestmark = pytest.mark.usefixtures("relaxed_limits")

ENDLESS = 100_000
GRAPHICS = """(name) => {
    window.graphics ??= document.querySelector("#view canvas").getContext("webgl2").getExtension("WEBGL_lose_context");
    window.graphics[name]?.();
}"""
"""Lets the graphics of the page fail, or come back. The emulator hides the canvas in VR: call it once before."""
BACKGROUND = """(state) => {
    Object.defineProperty(document, "visibilityState", { value: state, configurable: true });
    document.dispatchEvent(new Event("visibilitychange"));
}"""
"""Reports to the page that it is in the background: headless browsers keep every page in front."""


@pytest.fixture
def journey(tmp_path: Path) -> Iterator[Journey]:
    with ExitStack() as opened:
        session = plan(trial_steps=ENDLESS)
        yield Journey(tmp_path, session, constant_policies(session), opened)


def lost(journey: Journey) -> list[str]:
    return [
        each.visibility for each in journey.observed if isinstance(each, read_session_events.VisibilityLost)
    ]


def seen(journey: Journey) -> int:
    return sum(isinstance(each, read_session_events.VisibilityFound) for each in journey.observed)


def await_trial(session: Session) -> None:
    wait_until(lambda: session.phase_name == "trial")


@pytest.mark.slow
def test_in_vr(journey: Journey) -> None:
    headset, session = journey.headset, journey.session
    headset.page.evaluate(GRAPHICS, "")
    journey.enter()
    journey.calibrate()
    await_trial(session)

    def blur(state: str) -> None:
        headset.page.evaluate("(state) => window.avrgymEmulator.device.updateVisibilityState(state)", state)

    for number, state in enumerate(("visible-blurred", "hidden"), 1):
        blur(state)
        wait_until(lambda: session.phase_name == "paused")
        assert lost(journey)[-1] == state
        sent = headset.call_emulator("trackingSent")
        headset.page.wait_for_timeout(300)
        assert headset.call_emulator("trackingSent") == sent
        blur("visible")
        wait_until(lambda number=number: seen(journey) == number)
        assert session.phase_name == "paused"
        headset.page.get_by_text("You did not see the scene").first.wait_for(state="attached")
        journey.finish_phases("paused")
        await_trial(session)
    headset.page.evaluate(GRAPHICS, "loseContext")
    wait_until(lambda: session.phase_name != "trial")
    assert lost(journey)[-1] == "context-lost"
    assert journey.results() == ["interrupted"] * 3


def play(page: Page, session: Session) -> None:
    page.get_by_role("button", name="Play without a headset").click()
    wait_until(lambda: session.phase_name == "calibration")
    for phase in SEATING:
        while session.phase_name == phase:
            page.keyboard.press("Enter")
            page.wait_for_timeout(100)
    await_trial(session)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("script", "lose", "find", "state"),
    [
        (BACKGROUND, "hidden", "visible", "hidden"),
        (GRAPHICS, "loseContext", "restoreContext", "context-lost"),
    ],
    ids=["background", "graphics"],
)
def test_on_the_page(journey: Journey, script: str, lose: str, find: str, state: str) -> None:
    page, session = journey.headset.page, journey.session
    play(page, session)
    page.evaluate(script, lose)
    wait_until(lambda: session.phase_name == "paused")
    assert lost(journey) == [state]
    page.evaluate(script, find)
    wait_until(lambda: seen(journey) == 1)
    assert session.phase_name == "paused"
    page.get_by_text("Choose Go on to repeat the trial").first.wait_for()
    page.screenshot(path=journey.folder / "paused.png")
    page.get_by_role("button", name="Go on").click()
    await_trial(session)
    assert journey.results() == ["interrupted"]
