"""The page without a headset, in a real browser: texts, display and controls."""

import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, TimeoutError, sync_playwright

from avrgym.questionnaires.questionnaire import LIKERT_ITEMS, Item
from avrgym.recording.input_profile import InputProfile
from avrgym.recording.presentation import PresentationPreferences
from avrgym.vr.emulation.emulated_headset import CHROMIUM_FLAGS, find_chromium
from avrgym.vr.server.live_server import LiveServer
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from avrgym.vr.session.session import Session
from helpers.browser.accessibility import violations
from helpers.browser.choosers import GUARD_MS
from helpers.browser.journey import SEATING, TIMEOUT_S, wait_until
from helpers.vr.visit import ENVIRONMENT, constant_policies

pytestmark = pytest.mark.usefixtures("relaxed_limits")

ENDLESS = 100_000
TRIAL_STEPS = 200
CHAIR_AND_BED = (
    TrialPlan("avrgym/ScratchItchJaco-v1", "drive", seed=0, practice=True),
    TrialPlan("avrgym/ScratchItchJaco-v1", "drive", seed=2, practice=True),
    TrialPlan("avrgym/BedBathingJaco-v1", "drive", seed=1, practice=False),
)
QUESTIONS = (
    LIKERT_ITEMS[0],
    Item("sick", "Nausea", 4, "none", "severe", ("none", "slight", "moderate", "severe")),
    Item("line", "How hard was it?", points=21, low="very low", high="very high"),
)
SIZES = [(390, 844), (1280, 720)]
"""A phone's and a computer's, pixels."""


@pytest.fixture
def sessions(tmp_path: Path) -> Iterator[Callable[..., LiveServer]]:
    """Serves sessions of a plan, of one trial by default; ``observed`` receives the events."""
    with ExitStack() as opened:
        workers = opened.enter_context(ThreadPoolExecutor(1))

        def serve(
            observed: Callable[[events.SessionEvent], None] = lambda event: None,
            trials: Sequence[TrialPlan] = (TrialPlan(ENVIRONMENT, "drive", seed=3, practice=False),),
            **plan,
        ) -> LiveServer:
            whole = SessionPlan(list(trials), "woman", 0.3, is_simulated=True, countdown_s=0.3, **plan)

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
    page = opened_page(browser, server.participant_url)
    play(page, server)
    page.get_by_role("button", name="Stop the robot").dispatch_event("pointerdown")
    wait_until(lambda: server.session.phase_name == "paused")
    page.get_by_text("Choose Go on to repeat the trial").wait_for()
    assert page.get_by_role("button", name="Stop the robot").count() == 0
    assert [event.by for event in observed if isinstance(event, events.Stopped)] == ["participant"]


@pytest.mark.slow
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_axe_finds_no_violations_during_trials(
    size: tuple[int, int], sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    server = sessions(trial_steps=ENDLESS)
    page = opened_page(browser, server.participant_url, *size)
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
        watching = opened_page(browser, server.list_page_urls("spectator", token)[0], *size)
        watching.get_by_role("main").wait_for()
        found[role] = violations(watching)
        watching.close()
    assert found == {state: [] for state in found}


PARTICIPANTS = {
    "keyboard": (SIZES[0], InputProfile()),
    "one switch": (
        SIZES[1],
        InputProfile(
            "one-switch", presentation=PresentationPreferences(2.0, contrast="high", position="right")
        ),
    ),
    "two switches": (
        SIZES[0],
        InputProfile("two-switches", presentation=PresentationPreferences(3.0, captions=True)),
    ),
}


class PageChooser:
    """Selects the page's buttons by their labels, with keys alone."""

    def __init__(self, page: Page, profile: InputProfile) -> None:
        self._page, self._method = page, profile.method
        self.presses = 0

    def choose(self, label: str, done: Callable[[], bool]) -> None:
        """Select a button when it is visible, until something is done."""
        button = self._page.get_by_role("button", name=label, exact=True)
        while not done():
            if button.is_visible():
                self._select(label)
                self._page.wait_for_timeout(SETTLING_MS)

    def _select(self, label: str) -> None:
        page = self._page
        if self._method == "one-switch":
            with suppress(TimeoutError):
                page.wait_for_function(
                    f"(label) => {LABEL_OF_HIGHLIGHTED} === label", arg=label, polling=20, timeout=20_000
                )
                self._press("a")
            return
        steps = self._method == "two-switches"
        page.wait_for_timeout(GUARD_MS if steps else 0)
        for _ in range(MOST_STEPS):
            if page.evaluate(LABEL_OF_HIGHLIGHTED if steps else LABEL_OF_FOCUSED) == label:
                self._press("Enter")
                return
            self._press("Space" if steps else "Tab")
            page.evaluate(NEXT_FRAMES)

    def _press(self, key: str) -> None:
        self._page.keyboard.press(key)
        self.presses += 1


SETTLING_MS = 600.0
NEXT_FRAMES = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Waits until the page has drawn the new highlight."""
MOST_STEPS = 40
LABEL_OF_HIGHLIGHTED = "document.querySelector('.highlighted')?.textContent.trim()"
LABEL_OF_FOCUSED = "document.activeElement.textContent.trim()"


@pytest.mark.slow
@pytest.mark.parametrize("name", PARTICIPANTS)
def test_a_session_needs_only_keys_and_axe_finds_no_violations(
    name: str, sessions: Callable[..., LiveServer], browser: Browser
) -> None:
    """Calibration, practice in the chair, stop, break, trial in bed, numbers, words, a long scale, back, confirm."""
    size, profile = PARTICIPANTS[name]
    began = time.monotonic()
    observed: list[events.SessionEvent] = []
    server = sessions(
        observed.append, CHAIR_AND_BED, trial_steps=TRIAL_STEPS, items=QUESTIONS, input_profile=profile
    )
    page = opened_page(browser, server.participant_url, *size)
    chooser = PageChooser(page, profile)
    pressed = lambda label: not page.get_by_role("button", name=label, exact=True).is_visible()  # noqa: E731
    shows = lambda text: page.get_by_text(text).is_visible()  # noqa: E731
    found: dict[str, list[str]] = {}

    def check(state: str) -> None:
        if state not in found:
            found[state] = violations(page)

    def answer_line() -> None:
        done = lambda: page.get_by_role("button", name="Done").is_visible()  # noqa: E731
        if profile.method == "controllers":
            page.locator("#points input").focus()
            page.keyboard.press("End")
            chooser.choose("Take this answer", done)
        else:
            chooser.choose("21", lambda: pressed("16 – 20"))
            chooser.choose("21", done)

    chooser.choose("Play without a headset", lambda: shows("Leave the scene"))
    stopped = False
    while (phase := server.session.phase_name) != "questionnaire":
        if phase == "trial" and not stopped:
            page.keyboard.press("Escape" if profile.method == "controllers" else "Space")
            wait_until(lambda: server.session.phase_name != "trial")
            stopped = True
        elif page.get_by_role("button", name="Go on").is_visible():
            check(phase)
            if phase == "check" and "again" not in found:
                check("again")
                chooser.choose("Measure again", lambda: server.session.phase_name != "check")
            if "break" not in found and page.get_by_role("button", name="Take a break").is_visible():
                chooser.choose("Take a break", lambda: server.session.phase_name == "break")
                phase = "break"
                check(phase)
            chooser.choose("Go on", lambda before=phase: server.session.phase_name != before)
        page.wait_for_timeout(100.0)
    page.get_by_text(QUESTIONS[0].text).wait_for()
    check("buttons")
    chooser.choose("6", lambda: shows(QUESTIONS[1].text))
    check("words")
    chooser.choose("severe", lambda: shows(QUESTIONS[2].text))
    check("line")
    answer_line()
    check("confirm")
    chooser.choose("Back", lambda: shows(QUESTIONS[2].text))
    answer_line()
    chooser.choose("Done", lambda: shows("That was all"))
    check("finished")
    print(f"{name}: {(time.monotonic() - began) / 60:.1f} min, {chooser.presses} presses")
    assert found == {state: [] for state in found}
    assert {"calibration", "check", "paused", "break", "buttons", "words", "line", "confirm", "finished"} <= {
        *found
    }
    assert [event.by for event in observed if isinstance(event, events.Stopped)] == ["participant"]
    results = [event.result for event in observed if isinstance(event, events.TrialEnded)]
    assert results == ["stopped", "completed", "completed", "completed"]
    answers = [event.answer.value for event in observed if isinstance(event, events.Answered)]
    assert answers == [6, 4, 21]


def play(page: Page, server: LiveServer) -> None:
    """Take part without a headset, until measured and seated."""
    assert page.get_by_role("main").count() == page.get_by_role("region", name="The scene").count() == 1
    page.get_by_role("button", name="Play without a headset").click()
    page.get_by_text("Then choose Go on").wait_for()
    while server.session.phase_name in SEATING:
        if page.get_by_role("button", name="Go on").is_visible():
            page.keyboard.press("Enter")
        page.wait_for_timeout(300.0)
    assert "trigger" not in page.inner_text("body").lower()
