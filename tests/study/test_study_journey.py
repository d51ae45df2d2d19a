"""A study from enrolment to its check in a browser, with a kill of the server in a trial."""

import json
import signal
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.study.design.design import DESIGN_FILE, read_design
from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation.emulated_headset import DONE_BUTTON_VALUE, EmulatedHeadset
from avrgym.vr.emulation.simulated_participant import SimulatedParticipant, sample_participant_traits
from helpers.browser.journey import (
    SEATING,
    TIMEOUT_S,
    finish_phases,
    skip_drawing,
    wait_for_buttons,
    wait_for_phase,
)
from helpers.studies.small_studies import make_study
from helpers.system.processes import running_server
from helpers.vr.time_limits import RELAXED_LIMITS
from helpers.vr.visit import constant_policy

TASKS = ("Feeding", "ScratchItch")
ANSWERS = {"L1": 7, "L2": 6, "L3": 5, "L4": 4}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A study of two trials of 2 s, with a custom policy and one item before each session."""
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = make_study(
        tmp_path / "study",
        tasks=json.dumps(TASKS),
        robots='["Jaco"]',
        policies='["mine"]',
        practice_policy='""',
        trial_steps="20",
        free_movement_s="0.5",
    )
    with open(folder / "study.toml", "a") as file:
        file.write('[[questionnaires]]\nname = "before"\nwhen = "before_session"\n')
        file.write('items = [{ id = "nausea", text = "Sick?", points = 4, low = "no", high = "very" }]\n')
    for environment, (task, robot) in ENVIRONMENTS.items():
        (folder / "mine").mkdir(exist_ok=True)
        constant_policy(environment).save(folder / "mine" / f"{task}{robot}.safetensors")
    return folder


@pytest.mark.slow
def test_study_continues_after_a_server_crash(folder: Path) -> None:
    expect.set_options(timeout=1000 * TIMEOUT_S)
    participant = SimulatedParticipant(sample_participant_traits("woman", 5), 5)
    with (
        running_server(folder, limits=RELAXED_LIMITS) as server,
        EmulatedHeadset(server.participant, 320, 180) as headset,
    ):
        skip_drawing(headset)
        dashboard = open_dashboard(headset, server.dashboard)
        take_in(dashboard, folder)
        begin(dashboard, headset, "Begin session")
        sit_down(headset, participant)
        wait_for_buttons(headset, "L1")
        expect(dashboard.locator("#session-words")).to_contain_text("The participant answers questions")
        expect(dashboard.locator("#watch-trial")).to_contain_text("1 of 2")
        expect(dashboard.locator("#watch-steps")).to_contain_text("20 of 20")
        answer_all(headset)
        finish_phases(headset, "ready")
        await_attempt(headset, 2)
        server.process.send_signal(signal.SIGKILL)
        expect(dashboard.locator("#server")).to_contain_text("Connection lost")
    kept = digests(folder)
    assert states(folder) == ["completed", "running"]
    with (
        running_server(folder, limits=RELAXED_LIMITS) as server,
        EmulatedHeadset(server.participant, 320, 180) as headset,
    ):
        skip_drawing(headset)
        dashboard = open_dashboard(headset, server.dashboard)
        dashboard.get_by_role("button", name="sub-001").click()
        dashboard.get_by_role("button", name="Continue with the remaining trials").click()
        come_in(dashboard, headset)
        wait_for_phase(headset, "waiting")
        sit_down(headset, participant)
        answer_all(headset)
        wait_for_phase(headset, "finished")
        expect(dashboard.get_by_role("row", name="sub-001")).to_contain_text("completed")
    assert states(folder) == ["completed", "interrupted", "completed"]
    assert kept.items() <= digests(folder).items()
    checked = CliRunner().invoke(app, ["study", "check", str(folder)])
    assert (checked.exit_code, checked.stdout.splitlines()[-1]) == (0, "no errors")
    with StudyStore(folder) as store:
        given = [(answer.item, answer.value) for answer in store.read_answers("sub-001")]
    assert given == [("nausea", 2), *ANSWERS.items(), *ANSWERS.items()]


# What the experimenter does -----------------------------------------------------------------------------------


def open_dashboard(headset: EmulatedHeadset, address: str) -> Page:
    browser = headset.page.context.browser
    assert browser is not None
    page = browser.new_page(viewport={"width": 640, "height": 480})
    page.set_default_timeout(1000 * TIMEOUT_S)
    page.goto(address.replace("/dashboard#", "/dashboard?detail=light#"))
    expect(page.locator("#server")).to_contain_text("Connected")
    page.locator("#picture summary").dispatch_event("click")  # one renderer in software draws for both pages
    expect(page.locator("iframe")).to_have_count(0)
    return page


def take_in(dashboard: Page, folder: Path) -> None:
    """Enrol an eligible woman with consent."""
    dashboard.locator("summary", has_text="Enrol somebody").click()
    dashboard.get_by_label("Body model").select_option("woman")
    dashboard.get_by_role("button", name="Enrol", exact=True).click()
    dashboard.get_by_label("They have read version 1 and agree").check()
    dashboard.get_by_role("button", name="Record consent").click()
    questions = dashboard.locator("#questions").get_by_role("group")
    asked = read_design(folder / DESIGN_FILE).inclusion
    expect(questions).to_have_count(len(asked))
    for number, question in enumerate(asked):
        questions.nth(number).get_by_label("yes" if question.required else "no").check()
    dashboard.get_by_role("button", name="Record answers").click()
    expect(dashboard.get_by_role("row", name="sub-001")).to_contain_text("0 of 2")


def begin(dashboard: Page, headset: EmulatedHeadset, button: str) -> None:
    """Begin the session; the participant answers the question before it on their page."""
    dashboard.get_by_role("button", name=button).click()
    expect(dashboard.locator("#session-words")).to_contain_text("The participant answers questions")
    come_in(dashboard, headset)
    headset.page.locator("#points").get_by_role("button", name="2").click()
    headset.page.get_by_role("button", name="Done").click()
    wait_for_phase(headset, "waiting")


def come_in(dashboard: Page, headset: EmulatedHeadset) -> None:
    """Enter the code of the session on the headset's page."""
    code = dashboard.locator("#link-code")
    expect(code).to_be_visible()
    headset.page.bring_to_front()
    headset.page.locator("#code").fill(code.inner_text())
    headset.page.locator("#code").press("Enter")
    expect(headset.page.locator("#entrance")).to_be_hidden()


# What the participant does ------------------------------------------------------------------------------------


def sit_down(headset: EmulatedHeadset, participant: SimulatedParticipant) -> None:
    headset.set_poses(participant.make_tracking_frame(0.0, moving=False))
    headset.enter_vr()
    finish_phases(headset, *SEATING)


def answer_all(headset: EmulatedHeadset) -> None:
    for item, value in ANSWERS.items():
        wait_for_buttons(headset, item)
        headset.select_answer(value)
    wait_for_buttons(headset, "confirm")
    headset.select_answer(DONE_BUTTON_VALUE)


def await_attempt(headset: EmulatedHeadset, trial: int) -> None:
    """Wait until a trial has begun, when a kill can lose data."""
    headset.page.wait_for_function(
        "([trial]) => ((phase) => phase?.trial === trial && phase.name !== 'loading')(window.avrgymEmulator.phase())",
        arg=[trial],
        timeout=1000 * TIMEOUT_S,
    )


# What is left -------------------------------------------------------------------------------------------------


def states(folder: Path) -> list[str]:
    with StudyStore(folder) as store:
        return [attempt.state for attempt in store.read_attempts("sub-001")]


def digests(folder: Path) -> dict[str, str]:
    """The checksums of closed recordings; asserts that they match the files."""
    with StudyStore(folder) as store:
        return {each.recording: each.sha256 for each in store.read_attempts("sub-001") if each.sha256}
