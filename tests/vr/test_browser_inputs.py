"""Every kind of input in a real browser: each headset's inputs enter, calibrate, answer and go on.

The headsets are emulated: their controllers have the buttons, profiles and kinds of rays that the real ones have.
"""

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models.human import SKIN_TONES
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import read_recording
from avrgym.vr.emulation.emulated_headset import (
    AGAIN_BUTTON_VALUE,
    BACK_BUTTON_VALUE,
    CONTINUE_BUTTON_VALUE,
    DONE_BUTTON_VALUE,
)
from avrgym.vr.protocol.messages import XRPose
from avrgym.vr.session import events
from avrgym.vr.session.plan import SessionPlan, TrialPlan
from helpers.browser.journey import Journey, wait_until
from helpers.vr.visit import constant_policies

pytestmark = pytest.mark.usefixtures("relaxed_limits")

HEADSETS = (
    "quest-3",
    "quest-2",
    "pico-4",
    "vive",
    "mixed-reality",
    "generic-trigger",
    "one-button",
    "hands",
    "vision-pro",
    "viewer",
)
ENDLESS = 100_000
FIRST_TONE = 3
"""The panel's button after those of the two bodies."""


class Wearer:
    """Somebody who takes part with the inputs of one headset."""

    def __init__(self, headset: str, folder: Path, opened: ExitStack, *, trial_steps: int = 1) -> None:
        """Enter VR."""
        trial = TrialPlan("avrgym/FeedingJaco-v1", "drive", 0, practice=False)
        plan = SessionPlan(
            [trial], "woman", 0.3, is_simulated=True, questionnaire_items=LIKERT_ITEMS[:1], trial_steps=trial_steps,
            countdown_s=0.3
        )  # fmt: skip
        self.journey = Journey(folder, plan, constant_policies(plan), opened, query=f"&headset={headset}")
        self.headset, self.session = self.journey.headset, self.journey.session
        frame = self.journey.participant.make_tracking_frame(0.0, moving=False)
        assert frame.head is not None
        self._aside = _at_the_right(frame.head)
        self.headset.set_poses(frame)
        self.headset.enter_vr()
        self.headset.page.wait_for_function("() => !document.body.classList.contains('sceneless')")
        self.journey.wait_for_phase("calibration")

    def choose(self, item: str, value: int) -> None:
        """Choose a button once the panel has those of a question, of the ``check``, or to ``confirm``."""
        self.journey.wait_for_buttons(item)
        self.headset.wait_for_frames(10)
        self.headset.select_answer(value)

    def go_on(self, *phases: str) -> None:
        """Select nothing on the panel until phases are over."""
        self.headset.call_emulator("pointAt", self._aside)
        while self.headset.call_emulator("phase")["name"] in phases:
            self.headset.wait_for_frames(20)
            if self.headset.call_emulator("phase")["name"] in phases:
                self.headset.press_select()


def _at_the_right(head: XRPose) -> list[float]:
    """A place level with the eyes where no panel is."""
    x, y, z, w = head.orientation
    right = transforms.rotate(np.array([w, x, y, z]), np.array([5.0, 0.0, 0.0]))
    return [float(head.position[0] + right[0]), head.position[1], float(head.position[2] + right[2])]


@pytest.mark.slow
@pytest.mark.parametrize("name", HEADSETS)
def test_each_headset_completes_a_session(name: str, tmp_path: Path) -> None:
    with ExitStack() as opened:
        wearer = Wearer(name, tmp_path, opened)
        session = wearer.session
        wearer.choose("body", FIRST_TONE)
        wait_until(lambda: session.person.skin_tone == next(iter(SKIN_TONES)))
        assert session.phase_name == "calibration"
        wearer.go_on("calibration", "loading")
        wearer.choose("check", AGAIN_BUTTON_VALUE)
        wearer.journey.wait_for_phase("calibration")
        wearer.go_on("calibration", "loading")
        wearer.choose("check", CONTINUE_BUTTON_VALUE)
        wearer.choose(LIKERT_ITEMS[0].id, 6)
        wearer.choose("confirm", BACK_BUTTON_VALUE)
        wearer.choose(LIKERT_ITEMS[0].id, 2)
        wearer.choose("confirm", DONE_BUTTON_VALUE)
        wearer.journey.wait_for_phase("finished")
        (ended,) = [each for each in wearer.journey.observed if isinstance(each, events.TrialEnded)]
    assert ended.result == "completed"
    answers = read_recording(tmp_path / "trial-01_attempt-1.mcap").messages_by_topic["/answers"]
    assert [record.value for _, record in answers] == [6, 2]


WAYS = {
    "quest-3": "button",
    "quest-2": "button",
    "pico-4": "button",
    "vive": "triggers",
    "mixed-reality": "squeeze",
    "generic-trigger": "triggers",
    "one-button": "select",
    "hands": "palm",
    "vision-pro": "gaze",
    "viewer": "gaze",
}
"""How each headset stops the robot; what has no menu button but a squeeze stops with that, too."""


@pytest.mark.slow
@pytest.mark.parametrize("name", HEADSETS)
def test_each_headset_stops_the_robot_in_its_own_way(name: str, tmp_path: Path) -> None:
    """The sign shows how; the stop comes from what is held, and the trial is then repeated."""
    with ExitStack() as opened:
        wearer = Wearer(name, tmp_path, opened, trial_steps=ENDLESS)
        wearer.go_on("calibration", "loading", "check")
        wearer.journey.wait_for_phase("trial")
        wearer.headset.wait_for_frames(5)
        shown = wearer.headset.call_emulator("stop")
        assert shown["method"] == ("triggers" if WAYS[name] == "squeeze" else WAYS[name])
        assert (shown["sign"] is not None) == (WAYS[name] == "gaze")
        wearer.headset.save_screenshot(tmp_path / "sign.png")
        wearer.headset.begin_emergency_stop(WAYS[name])
        wearer.journey.wait_for_phase("paused")
        observed = wearer.journey.observed
        assert [each.way for each in observed if isinstance(each, events.Stopped)] == [WAYS[name]]
        assert wearer.journey.results() == ["stopped"]
