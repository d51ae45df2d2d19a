"""Sessions in a real browser: one through all tasks with either robot, and one that does not go smoothly.

The emulated headset proves logic and protocol. Trials are short; frame rates and durations are never asserted.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from avrgym.models.human import SKIN_TONES
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation.emulated_headset import BrowserClient
from avrgym.vr.session import events as read_session_events
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from helpers.browser.journey import TIMEOUT_S, Journey, wait_until
from helpers.vr.visit import constant_policies

pytestmark = pytest.mark.usefixtures("relaxed_limits")

MIXED = (
    "avrgym/FeedingPR2-v1",
    "avrgym/DrinkingJaco-v1",
    "avrgym/ScratchItchPR2-v1",
    "avrgym/BedBathingJaco-v1",
    "avrgym/DressingJaco-v1",
    "avrgym/ArmManipulationPR2-v1",
    *(name for name in ENVIRONMENTS if name == "avrgym/FeedingStretch-v1"),
)
"""All tasks, both robots and a driving one; in process ``test_mixed_session`` goes through all environments."""
ENDLESS = 100_000
FIRST_TONE = 3
"""The panel's button after those of the two bodies."""


@pytest.fixture
def journey(tmp_path: Path) -> Iterator[Callable[[SessionPlan], Journey]]:
    with ExitStack() as opened:
        yield lambda plan: Journey(tmp_path, plan, constant_policies(plan), opened)


def plan(*environments: str, steps: int) -> SessionPlan:
    """A short trial in each environment, with one question."""
    trials = [
        TrialPlan(environment, "drive", seed, practice=False) for seed, environment in enumerate(environments)
    ]
    return SessionPlan(
        trials,
        "woman",
        0.3,
        is_simulated=True,
        questionnaire_items=LIKERT_ITEMS[:1],
        trial_steps=steps,
        countdown_s=0.3,
    )


@pytest.mark.slow
def test_every_task_with_one_robot_or_the_other(
    journey: Callable[[SessionPlan], Journey], tmp_path: Path
) -> None:
    """Take place, move freely, be helped, answer, go on, leave: in wheelchair and bed, by several robots. The
    recordings are replayed bit by bit."""
    whole = journey(plan(*MIXED, steps=5))
    BrowserClient(whole.headset, whole.session, whole.participant, tmp_path, lambda words: None).run()
    recordings = [read_recording(path) for path in whole.session.recordings]
    completed = [each for each in recordings if each.outcome and each.outcome.result == "completed"]
    assert [each.configuration.environment for each in completed] == list(MIXED)
    for each in completed:
        assert each.is_complete
        assert [record.step for _, record in each.messages_by_topic["/control"]] == [1, 2, 3, 4, 5]
        assert len(each.messages_by_topic["/answers"]) == 1
        assert any(record.moved_person for _, record in each.messages_by_topic["/tracking"])
        assert verify_recording(each).is_identical
    whole.headset.page.get_by_role("button", name="Leave VR").click()
    wait_until(lambda: not whole.headset.call_emulator("presenting"))


@pytest.mark.slow
def test_a_session_with_interruptions(journey: Callable[[SessionPlan], Journey]) -> None:
    """Body, stop, second visitor, lost connections, reload: whatever happens the trial is repeated."""
    visit = journey(plan("avrgym/FeedingJaco-v1", steps=ENDLESS))
    headset, session = visit.headset, visit.session
    visit.enter()
    visit.wait_for_buttons("body")
    headset.select_answer(FIRST_TONE)
    wait_until(lambda: session.person.skin_tone == next(iter(SKIN_TONES)))
    assert session.phase_name == "calibration"
    headset.set_poses(visit.participant.make_tracking_frame(1.0, moving=False))
    visit.calibrate()
    visit.wait_for_phase("trial")

    headset.press_menu("left")
    visit.wait_for_phase("paused")
    assert visit.results() == ["stopped"]
    assert [each.by for each in visit.observed if isinstance(each, read_session_events.Stopped)] == [
        "participant"
    ]
    visit.finish_phases("paused")
    visit.wait_for_phase("trial")

    browser = headset.page.context.browser
    assert browser is not None
    second = browser.new_page()
    second.set_default_timeout(1000 * TIMEOUT_S)
    second.goto(visit.server.participant_url)
    second.get_by_text("Another page already takes part").first.wait_for()
    assert session.phase_name == "trial"
    second.close()

    for count in (2, 3):
        visit.drop_sockets()
        wait_until(lambda count=count: len(visit.results()) == count)
        visit.calibrate()
        visit.wait_for_phase("trial")

    headset.page.reload()
    wait_until(lambda: session.phase_name == "waiting")
    headset.page.wait_for_function("() => window.avrgymEmulator !== undefined", timeout=1000 * TIMEOUT_S)
    visit.enter()
    visit.calibrate()
    visit.wait_for_phase("trial")
    assert visit.results() == ["stopped", *["interrupted"] * 3]
    assert [path.name for path in session.recordings] == [f"trial-01_attempt-{n}.mcap" for n in range(1, 6)]
    assert {read_recording(path).configuration.person.skin_tone for path in session.recordings} == {"light"}
