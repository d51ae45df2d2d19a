"""Layout of the client's pages at every window size: stop button, hand buttons and scene."""

import colorsys
import re
from pathlib import Path

import pytest
from playwright.sync_api import Browser, FloatRect, Locator, Page

from avrgym.models.human import SKIN_TONES
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.protocol.messages import (
    PROTOCOL_VERSION,
    AvailableRobotCommands,
    CommandLabel,
    Message,
    ParticipantBody,
    PhaseDescription,
    Role,
    Scene,
    SessionStatus,
    TickTiming,
    Welcome,
    WorldState,
)
from avrgym.vr.protocol.state_encoding import StateEncoder
from avrgym.vr.scene.export_process import export_scene
from helpers.browser.accessibility import violations
from helpers.browser.journey import DRAW_LITTLE
from helpers.browser.staged_page import StagedPage
from helpers.vr.visit import Visit, plan

pytestmark = pytest.mark.slow

WIDTHS, HEIGHTS = (320, 390, 768, 1024, 1366, 1920, 2560), (480, 768, 1080)
SIZES = [(width, height) for width in WIDTHS for height in HEIGHTS]
FEW = [(320, 480), (390, 844), (1366, 768)]
NAME = "Stop the robot"
RECTANGLES = """(ids) => ids.map((id) => {
    const { left, top, right, bottom } = document.getElementById(id).getBoundingClientRect();
    return [left, top, right, bottom];
})"""
VISIBLE_CONTROLS = """[...document.querySelectorAll("button, select, input")]
    .filter((each) => each.getClientRects().length).map(({ id, textContent }) => id || textContent)"""
UNCOVERED = """(button) => {
    const { left, top, right, bottom } = button.getBoundingClientRect();
    return [[left + 12, top + 12], [right - 12, top + 12], [(left + right) / 2, (top + bottom) / 2],
        [left + 12, bottom - 12], [right - 12, bottom - 12]]
        .every(([x, y]) => x >= 0 && y >= 0 && x < innerWidth && y < innerHeight
            && button.contains(document.elementFromPoint(x, y)));
}"""


@pytest.fixture(scope="module")
def said(tmp_path_factory: pytest.TempPathFactory) -> list[Message]:
    """What a session says of a trial that goes on."""
    visit = Visit(tmp_path_factory.mktemp("visit"), plan(trial_steps=1000))
    visit.go_to("trial")
    visit.tick(100)
    latest = [visit.received(kind)[-1] for kind in (PhaseDescription, SessionStatus)]
    return [*latest, TickTiming(tick_ms_median=3.2, tick_ms_max=7.9, missed_ticks=0)]


def welcome(role: Role) -> Welcome:
    return Welcome(protocol=PROTOCOL_VERSION, session="s", role=role, haptics=True, sounds=True)


def stage(
    browser: Browser, role: Role, said: list[Message], name: str, query: str = "?detail=light"
) -> StagedPage:
    page = browser.new_page(viewport={"width": 1366, "height": 768})
    page.add_init_script(f"({DRAW_LITTLE})()")
    staged = StagedPage(page, [welcome(role), *said])
    staged.open(name, query)
    if role == "participant":
        page.get_by_role("button", name="Play without a headset").click()
    page.get_by_role("button", name=NAME).wait_for()
    return staged


STAGES: dict[str, tuple[Role, str]] = {
    "participant": ("participant", "index.html"),
    "experimenter": ("experimenter", "spectator"),
    "dashboard": ("experimenter", "dashboard.html"),
}


@pytest.mark.parametrize("name", STAGES)
def test_the_stop_button_is_visible_and_works_at_every_size(
    name: str, browser: Browser, said: list[Message]
) -> None:
    """Also at the end of a page that scrolls."""
    role, file = STAGES[name]
    staged = stage(browser, role, said, file)
    page, stop = staged.page, staged.page.get_by_role("button", name=NAME)
    faults = []
    for width, height in SIZES:
        page.set_viewport_size({"width": width, "height": height})
        for end in (0, 100_000):
            page.evaluate("(y) => window.scrollTo(0, y)", end)
            page.wait_for_timeout(30.0)
            if not stop.evaluate(UNCOVERED):
                faults.append((width, height, end, "covered"))
            before = staged.kinds().count("stop")
            press(page, box_of(stop))
            if not became(lambda before=before: staged.kinds().count("stop") > before, page):
                faults.append((width, height, end, "does nothing"))
    assert faults == []
    assert "Esc" in stop.inner_text()
    assert is_red(stop.evaluate("(button) => getComputedStyle(button).backgroundColor"))
    page.close()


def box_of(button: Locator) -> FloatRect:
    box = button.bounding_box()
    assert box is not None
    return box


def press(page: Page, box: FloatRect) -> None:
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)


def became(condition, page: Page) -> bool:
    """Whether something comes to be so."""
    for _ in range(200):
        if condition():
            return True
        page.wait_for_timeout(10.0)
    return False


def is_red(colour: str) -> bool:
    red, green, blue = (int(number) / 255 for number in re.findall(r"\d+", colour)[:3])
    hue, saturation, _ = colorsys.rgb_to_hsv(red, green, blue)
    return saturation > 0.6 and (hue < 0.06 or hue > 0.95)


@pytest.mark.parametrize("name", STAGES)
def test_the_key_on_the_stop_stops(name: str, browser: Browser, said: list[Message]) -> None:
    role, file = STAGES[name]
    staged = stage(browser, role, said, file)
    staged.page.keyboard.press("Escape")
    assert became(lambda: "stop" in staged.kinds(), staged.page)
    assert staged.page.get_by_role("button", name=NAME).count() == 1
    assert staged.page.get_by_role("button", name=NAME).get_attribute("aria-keyshortcuts") == "Escape"
    staged.page.close()


def test_an_experimenter_has_the_stop_before_the_robot_moves(browser: Browser, said: list[Message]) -> None:
    waiting = PhaseDescription(name="waiting", text="", trial=0, trials=2, practice=False, seconds=None)
    staged = stage(browser, "experimenter", [waiting], "spectator")
    assert staged.page.get_by_role("button", name=NAME).is_visible()
    staged.page.close()


@pytest.mark.parametrize("role", ["spectator", "caregiver"])
def test_pages_of_watchers_show_no_choices(role: Role, browser: Browser, said: list[Message]) -> None:
    """Watchers choose only their view. Body, commands and the stop are choices of other pages."""
    page = browser.new_page()
    commands = AvailableRobotCommands(
        [CommandLabel("wait", "Wait")], ["caregiver", "experimenter"], "", 1.0, 0.15
    )
    body = ParticipantBody("woman", next(iter(SKIN_TONES)), list(SKIN_TONES), list(SKIN_TONES.values()))
    staged = StagedPage(page, [welcome(role), body, *said, commands])
    staged.open("spectator")
    page.get_by_text("of 1000").wait_for()
    assert page.evaluate(VISIBLE_CONTROLS) == ["from-inside"]
    page.close()


def test_controls_do_not_overlap_while_playing(browser: Browser, said: list[Message]) -> None:
    staged = stage(browser, "participant", said, "index.html")
    faults = []
    for width, height in SIZES:
        staged.page.set_viewport_size({"width": width, "height": height})
        staged.page.wait_for_timeout(50.0)
        boxes: dict[str, list[float]] = dict(
            zip(
                ("card", "hand", "emergency"),
                staged.page.evaluate(RECTANGLES, ["card", "hand", "emergency"]),
                strict=True,
            )
        )
        for one, other in (("card", "hand"), ("card", "emergency"), ("hand", "emergency")):
            if overlap(boxes[one], boxes[other]):
                faults.append((width, height, one, other))
        _, top, right, _ = boxes["card"]
        if max((width - right) * height, top * width) < 0.4 * width * height:
            faults.append((width, height, "little room", boxes["card"]))
    assert faults == []
    staged.page.close()


def overlap(one: list[float], other: list[float]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def test_the_hands_buttons_form_a_cross(browser: Browser, said: list[Message]) -> None:
    """Up, left, right and down around a middle, away and towards you next to them, each labelled."""
    staged = stage(browser, "participant", said, "index.html")
    for size in FEW:
        staged.page.set_viewport_size({"width": size[0], "height": size[1]})
        place = {
            button.get_attribute("data-code"): box_of(button)
            for button in staged.page.locator("#hand button").all()
        }
        up, down, left, right, ahead, back = (
            place[f"Key{letter}"] for letter in ("E", "Q", "A", "D", "W", "S")
        )
        assert up["x"] == down["x"]
        assert left["y"] == right["y"]
        assert up["y"] < left["y"] < down["y"]
        assert left["x"] < up["x"] < right["x"] < ahead["x"]
        assert ahead["x"] == back["x"]
        assert ahead["y"] < back["y"]
        assert min(box["width"] for box in place.values()) >= 44
        assert min(box["height"] for box in place.values()) >= 44
        clipped = "(b) => b.scrollWidth > b.clientWidth + 1 || b.scrollHeight > b.clientHeight + 1"
        assert not any(button.evaluate(clipped) for button in staged.page.locator("#hand button").all())
    staged.page.close()


@pytest.mark.parametrize("size", FEW, ids=str)
def test_axe_finds_no_violations(size: tuple[int, int], browser: Browser, said: list[Message]) -> None:
    found = {}
    for name, (role, file) in STAGES.items():
        staged = stage(browser, role, said, file)
        staged.page.set_viewport_size({"width": size[0], "height": size[1]})
        found[name] = violations(staged.page)
        staged.page.close()
    assert found == {name: [] for name in STAGES}


@pytest.mark.parametrize("size", FEW, ids=str)
def test_no_figure_is_doubled_or_cut_off(
    size: tuple[int, int], browser: Browser, said: list[Message]
) -> None:
    """On the pages of those who watch; the limit of a force is named in newtons."""
    for name in ("experimenter", "dashboard"):
        role, file = STAGES[name]
        staged = stage(browser, role, said, file)
        page = staged.page
        page.set_viewport_size({"width": size[0], "height": size[1]})
        page.get_by_text("of 1000").wait_for()
        cut = "(all) => all.filter((d) => d.scrollWidth > d.clientWidth + 1).map((d) => d.id)"
        assert page.locator("dd").evaluate_all(cut) == []
        text = page.inner_text("body")
        assert len(re.findall(r"of 1000", text)) == 1
        assert len(re.findall(r"\b1 of 1\b", text)) <= 1
        assert "Of force limit" in text
        page.close()


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_the_card_never_hides_the_robot(environment: str, browser: Browser, tmp_path: Path) -> None:
    """Who watches sees its tool beside the card, on a computer and on a phone; else an arrow would stand on screen."""
    visit = Visit(tmp_path, plan(trial_steps=1000, environments=[environment]))
    visit.go_to("trial")
    visit.tick(10)
    shown = [visit.received(kind)[-1] for kind in (Scene, PhaseDescription, SessionStatus)]
    page = browser.new_page(viewport={"width": 1366, "height": 768})
    page.add_init_script(f"({DRAW_LITTLE})()")
    staged = StagedPage(
        page, [welcome("experimenter"), *shown], export_scene(environment, visit.session.person)
    )
    staged.open("spectator")
    page.wait_for_function("() => !document.body.classList.contains('sceneless')", timeout=120_000)
    staged.send(StateEncoder().encode(visit.received(WorldState)[-1]))
    for width, height in ((1366, 768), (390, 844), (1920, 1080)):
        page.set_viewport_size({"width": width, "height": height})
        page.wait_for_timeout(300.0)
        page.wait_for_function("() => document.getElementById('whereabouts').hidden", timeout=20_000)
    page.close()
