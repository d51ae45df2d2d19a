"""The way of a participant in a browser with an emulated headset, and the experimenter's pages."""

from pathlib import Path

import pytest
from playwright.sync_api import Browser, ViewportSize, expect

from avrgym.hosting.computers import LocalComputer
from avrgym.hosting.host import StudyHost
from avrgym.study.checking.study_checks import check_study
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.texts.interface_texts import ENGLISH_TEXTS
from avrgym.vr.emulation.emulated_headset import (
    DONE_BUTTON_VALUE,
    EmulatedHeadset,
)
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from helpers.browser.accessibility import violations
from helpers.browser.journey import (
    SEATING,
    TIMEOUT_S,
    finish_phases,
    skip_drawing,
    wait_for_buttons,
    wait_for_phase,
)
from helpers.hosting.served_host import Served
from helpers.hosting.slow_sessions import run_slow_session
from helpers.studies.small_studies import make_study
from helpers.vr.visit import constant_policy

pytestmark = pytest.mark.slow
TEXTS = ENGLISH_TEXTS.page
ANSWERS = {"L1": 7, "L2": 6, "L3": 5, "L4": 4}
PHONE = ViewportSize(width=390, height=844)
DESKTOP = ViewportSize(width=1440, height=900)


class HomeHeadset(EmulatedHeadset):
    """The browser of a headset at home. It opens the participant's own page, then the page of the session."""

    def __init__(self, browser: Browser) -> None:  # the base class opens the page of a session
        self._browser = browser
        self.page = browser.new_page(viewport=PHONE)
        self.page.set_default_timeout(1000 * TIMEOUT_S)

    def choose(self, text: str) -> None:
        """Choose the button or link with a text of the participant's page. Before it, axe checks the page."""
        chosen = self.page.get_by_role("button", name=TEXTS[text], exact=True)
        chosen = chosen.or_(self.page.get_by_role("link", name=TEXTS[text], exact=True))
        expect(chosen).to_be_visible()
        assert violations(self.page) == [], text
        chosen.click()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A hosted study with the headset check and one short trial."""
    folder = make_study(
        tmp_path / "study",
        tasks='["Feeding"]',
        robots='["Jaco"]',
        policies='["mine"]',
        practice_policy='""',
        trial_steps="20",
        free_movement_s="0.5",
    )
    environment = next(name for name, pair in ENVIRONMENTS.items() if pair == ("Feeding", "Jaco"))
    (folder / "mine").mkdir()
    constant_policy(environment).save(folder / "mine" / "FeedingJaco.safetensors")
    (folder / "host.toml").write_text('[completed]\ncode = "DONE-7"\n')
    return folder


def test_participant_at_home_from_the_link_to_the_code(folder: Path, browser: Browser) -> None:
    headset, computer = HomeHeadset(browser), LocalComputer(run_slow_session)
    with StudyStore(folder) as store, StudyHost(store, computers=lambda: [computer]) as host:
        served = Served(host)
        headset.page.goto(f"{host.public_url}/?emulate=1#invitation={served.invite()}")
        headset.choose("host_take_part")
        headset.choose("host_agree")
        for question in store.design.inclusion:
            group = headset.page.get_by_role("group", name=question.text)
            group.get_by_label(TEXTS["host_yes" if question.required else "host_no"]).check()
        headset.choose("host_send")
        headset.choose("host_safe")
        headset.choose("host_start")
        skip_drawing(headset)
        headset.choose("host_enter")
        watch_session(browser, host)
        pass_headset_check(headset)
        complete_trial(headset)
        headset.page.get_by_role("link", name=TEXTS["host_own_page"]).dispatch_event("click")
        expect(headset.page.get_by_text(TEXTS["host_your_code"].format(code="DONE-7"))).to_be_visible()
        assert violations(headset.page) == []
        assert [each.state for each in store.read_participants()] == ["completed"]
        assert {each.item: each.value for each in store.read_answers("sub-001")} == ANSWERS
        check = store.read_sessions("sub-001")[-1].latest_headset_check
        assert check is not None
        assert (check.vibration_felt, check.sound_heard, check.stop_method) == (True, True, "button")
        assert [each for each in check_study(store) if each.is_error] == []


def pass_headset_check(headset: EmulatedHeadset) -> None:
    """Enter VR, and answer the questions of the headset check."""
    participant = SimulatedParticipant(sample_participant_traits("woman", 5), 5)
    headset.page.wait_for_function("() => window.avrgymEmulator !== undefined")
    headset.set_poses(participant.make_tracking_frame(0.0, moving=False))
    headset.enter_vr()
    finish_phases(headset, "headset")
    headset.page.wait_for_function("() => window.avrgymEmulator.phase().name === 'headset_stop'")
    headset.press_menu("left")
    for item in ("haptics", "sound"):
        wait_for_buttons(headset, item)
        headset.select_answer(1)


def complete_trial(headset: EmulatedHeadset) -> None:
    """Be measured, take part in the trial, and answer its questions."""
    participant = SimulatedParticipant(sample_participant_traits("woman", 5), 5)
    headset.set_poses(participant.make_tracking_frame(0.0, moving=False))
    finish_phases(headset, "headset", *SEATING)
    for item, value in ANSWERS.items():
        wait_for_buttons(headset, item)
        headset.select_answer(value)
    wait_for_buttons(headset, "confirm")
    headset.select_answer(DONE_BUTTON_VALUE)
    wait_for_phase(headset, "finished")


def watch_session(browser: Browser, host: StudyHost) -> None:
    """The experimenter opens the session from the page of all sessions, and the page of all participants."""
    page = browser.new_page(viewport=DESKTOP)
    page.context.set_default_timeout(1000 * TIMEOUT_S)
    page.goto(host.experimenter_url)
    with page.expect_popup() as opened:
        page.get_by_role("link", name="Open the session of sub-001").click()
    watched = opened.value
    expect(watched.locator("#status-words")).to_contain_text("Connected")
    expect(watched.get_by_role("button", name="End session")).to_be_enabled()
    watched.close()
    page.get_by_role("link", name="Participants").dispatch_event("click")
    expect(page.get_by_role("row", name="sub-001")).to_contain_text("allocated")
    expect(page.locator("#session")).to_be_hidden()
    assert violations(page) == []
    page.close()
