"""Images of both eyes in every phase, one sheet per environment: `make soak`.

``SOAK_PICTURES`` is the folder of the sheets. The client advances the session's clock: a phase lasts until its image
is rendered.
"""

import os
import threading
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image, ImageDraw

from avrgym.models import human
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.tasks.registry import ENVIRONMENTS
from avrgym.vr.emulation import emulated_headset
from avrgym.vr.emulation.emulated_headset import BrowserClient
from avrgym.vr.protocol.messages import TICK_S, ExperimenterCommand
from avrgym.vr.server import real_time_loop
from avrgym.vr.session.plan import HeadsetCheckPlan, SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session
from helpers.browser.journey import Journey, draw_triangles, wait_until

pytestmark = pytest.mark.usefixtures("relaxed_limits")
COLUMNS, CAPTION_HEIGHT = 3, 14
TICKS_PER_LOOK = 25
IMAGE_AFTER_S = {
    "headset": 0.5, "headset_check": 0.2, "calibration": 0.5, "check": 0.5, "free_before": 1.0, "countdown": 0.2,
    "trial": 4.0, "paused": 0.5, "retreat": 1.5, "free_after": 0.5, "questionnaire": 0.5, "confirm": 0.5,
}  # fmt: skip
"""Time of the image after the start of each phase."""
LOOKING_DOWN_RAD = human.make_seated_joint_angles(head_x=45.0) - human.make_seated_joint_angles(head_x=0.0)


class SteppedClock:
    """A session clock that advances on request."""

    def __init__(self) -> None:
        self._ticks, self._let, self._waits = 0, threading.Semaphore(0), True

    def now_s(self) -> float:
        """Return the time on the session's clock."""
        return self._ticks * TICK_S

    def pause(self, session: Session) -> None:
        """Pause the session."""
        tick = session.tick

        def wait_and_tick(now_s: float) -> None:
            if self._waits:
                self._let.acquire()
            tick(now_s)
            self._ticks += 1

        session.tick = wait_and_tick

    def advance(self, ticks: int) -> None:
        """Advance by ticks, and wait until they are done."""
        ends = self._ticks + ticks
        self._let.release(ticks)
        wait_until(lambda: self._ticks >= ends)

    def resume(self) -> None:
        """Resume real time."""
        self._waits = False
        self._let.release()


class Photographer(BrowserClient):
    """A client that saves an image of every phase, stops the robot once, and looks down in the body check.

    The experimenter skips the headset check, which an emulated headset does not pass.
    """

    def __init__(self, journey: Journey, time: SteppedClock) -> None:
        super().__init__(
            journey.headset,
            journey.session,
            journey.participant,
            journey.folder,
            lambda words: None,
            IMAGE_AFTER_S,
        )
        self._loop, self._time, self._stops = journey.server.loop, time, True

    def _notice(self, phase: dict[str, Any], now_s: float) -> None:
        super()._notice(phase, self._time.now_s())

    def _act(self, question: dict[str, Any] | None, now_s: float) -> None:
        self._time.advance(TICKS_PER_LOOK)
        if self._is_to_be_pictured:
            self._headset.set_poses(self._frame(), right=question is None)
            self._take_picture(self._time.now_s())
        elif self._stops and self._phase[0] == "trial":
            self._headset.press_menu("left")
            self._stops = False
        elif self._phase[0] == "headset_check":
            self._loop.post(ExperimenterCommand(name="skip"))
        else:
            super()._act(question, self._time.now_s())

    @property
    def _is_to_be_pictured(self) -> bool:
        return self._phase[0] in IMAGE_AFTER_S and self._picture not in self.screenshots

    def _frame(self) -> Any:
        name, now_s = self._phase[0], self._time.now_s()
        if name != "check":
            return self._participant.make_tracking_frame(
                now_s, moving=name != "calibration", watching=name == "trial"
            )
        return self._participant.make_tracking_frame_from_angles(
            self._participant._rest_rad + LOOKING_DOWN_RAD, now_s
        )

    def _take_picture(self, now_s: float) -> None:
        if now_s - self._phase_began > IMAGE_AFTER_S.get(self._phase[0], np.inf):
            draw_triangles(self._headset)
            super()._take_picture(now_s)
            self._headset.page.evaluate("() => { window.drawsTriangles = false; }")


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_every_phase_is_pictured(environment: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    time = SteppedClock()
    monkeypatch.setattr(real_time_loop, "_clock_s", time.now_s)
    monkeypatch.setattr(emulated_headset, "MAX_PHASE_DURATION_S", float("inf"))
    plan = SessionPlan(
        [TrialPlan(environment, "revised", seed=3, practice=False)],
        "woman",
        free_movement_s=3.0,
        is_simulated=True,
        questionnaire_items=LIKERT_ITEMS[:1],
        trial_steps=60,
        headset_check=HeadsetCheckPlan(2.0, 2.0, 2.0),
    )
    with ExitStack() as opened:
        how = {"width": 640, "height": 360, "query": "&detail=full"}
        journey = Journey(tmp_path, plan, load_policies(plan), opened, **how)
        opened.callback(time.resume)
        journey.wait_for_phase("waiting")
        journey.headset.page.wait_for_function("() => window.avrgymEmulator.statesReceived() > 0")
        time.pause(journey.session)
        taken = Photographer(journey, time).run()
        draw_triangles(journey.headset)
        taken.append(journey.headset.save_screenshot(tmp_path / "trial-99-finished.png"))
    assert {path.stem.split("-")[2] for path in taken} == {*IMAGE_AFTER_S, "finished"}
    contact_sheet(taken, environment)


def contact_sheet(pictures: list[Path], environment: str) -> None:
    """Save all images on one sheet with their names."""
    folder = os.environ.get("SOAK_PICTURES")
    if folder is None:
        return
    opened = [Image.open(path).convert("RGB") for path in pictures]
    width, height = opened[0].width, opened[0].height + CAPTION_HEIGHT
    rows = -(-len(opened) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * width, rows * height), "white")
    for number, (path, picture) in enumerate(zip(pictures, opened, strict=True)):
        left, top = number % COLUMNS * width, number // COLUMNS * height
        sheet.paste(picture, (left, top + CAPTION_HEIGHT))
        ImageDraw.Draw(sheet).text((left + 4, top), path.stem, fill="black")
    Path(folder).mkdir(parents=True, exist_ok=True)
    sheet.save(Path(folder) / f"{environment.removeprefix('avrgym/')}.jpg", quality=85)
