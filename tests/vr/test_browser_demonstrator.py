"""Two headsets in one world: a participant, and a caregiver who feeds them with the robot."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.recording.reader import read_recording
from avrgym.replay.verification import verify_recording
from avrgym.vr.emulation.emulated_headset import EmulatedHeadset
from avrgym.vr.emulation.simulated_demonstrator import SimulatedDemonstrator
from avrgym.vr.live_world import drivers
from avrgym.vr.live_world.drivers import OperatorDriver
from avrgym.vr.live_world.world import LiveWorld
from avrgym.vr.protocol.messages import TICK_S, ControllerPoseCommand
from avrgym.vr.protocol.webxr import Pose, compute_controller_pose
from avrgym.vr.server.real_time_loop import RealTimeLoop
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session
from helpers.browser.journey import SEATING, TIMEOUT_S, Journey, draw_triangles, skip_drawing, wait_until
from helpers.vr.visit import result

pytestmark = pytest.mark.usefixtures("relaxed_limits")
REST_M = np.array([0.2, 1.2, -0.5])
"""Position of the caregiver's hand in their room while they do not drive."""
STEPS = 150
SUBSTEPS = 10
"""Ticks of a control step."""


class Pace:
    """Lets the world run until a tick, so that it waits for the pages of a busy machine. ``until``: this tick."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.until = np.inf
        wait = RealTimeLoop._wait

        def wait_for_pages(loop: RealTimeLoop[Session], due: float) -> float:
            while loop.session.world.ticks >= self.until and not loop._stopping.is_set():
                time.sleep(0.2 * TICK_S)
            return wait(loop, due)

        patch.setattr(RealTimeLoop, "_wait", wait_for_pages)
        patch.setattr(drivers, "OPERATOR_COMMAND_TIMEOUT_S", 60.0)


def caregivers_hand(steer: ControllerPoseCommand) -> Pose:
    """The pose of the simulated demonstrator's hand in the world."""
    assert steer.grip is not None
    pose = compute_controller_pose(steer.grip, steer.xr_from_world)
    assert pose is not None
    return pose


def is_near_mouth(world: LiveWorld) -> bool:
    state = world.simulation.get_state()
    return float(np.linalg.norm(state.mouth_pos_w[0] - state.tool_pos_w[0])) < 0.1


def take_picture(headset: EmulatedHeadset, path: Path) -> None:
    draw_triangles(headset)
    headset.save_screenshot(path)
    headset.page.evaluate("() => { window.drawsTriangles = false; }")


class CaregiversHeadset(EmulatedHeadset):
    """The page of the demonstrator, in the browser of another headset."""

    def __init__(self, journey: Journey) -> None:
        self._journey = journey
        self.page = journey.headset._browser.new_page(viewport={"width": 640, "height": 360})
        self.page.set_default_timeout(1000 * TIMEOUT_S)
        skip_drawing(self)
        address = journey.server.list_page_urls("demonstrator", journey.server.tokens.demonstrator)[0]
        self.page.goto(address.replace("#", "?emulate=1#"))
        self.page.wait_for_function("() => window.avrgymEmulator?.lastState()")
        self.page.get_by_role("button", name="Robot's camera").click()
        take_picture(self, journey.folder / "page.png")
        self.enter_vr()

    def feed(self, pace: Pace) -> Iterator[None]:
        """Follow the expert with the right hand until the food is eaten. Yields after each control step."""
        session = self._journey.session
        world, driver = session.world, session._state.driver
        assert isinstance(driver, OperatorDriver)
        pace.until = world.ticks
        hand, ticks = SimulatedDemonstrator(0), 0
        hand.begin_episode(world)
        start = caregivers_hand(hand.make_controller_message(world, 0.0))
        self.move(REST_M, transforms.IDENTITY_QUATERNION)
        self.call_emulator("setSqueeze", "right", True)

        def clutched() -> bool:
            pace.until = world.ticks + 1
            return driver._clutch is not None

        wait_until(clutched)
        assert driver._clutch is not None
        x, y, z, w = driver._clutch[0].orientation
        room_q = np.array([w, x, y, z])
        first_tick = world.ticks
        attempt = session._state.attempt_storage.attempt
        assert attempt is not None
        while not attempt.success and attempt.steps < STEPS - 1:
            clutch, pose = True, start
            while ticks < world.ticks - first_tick:
                ticks += 1
                steer = hand.make_controller_message(world, ticks * TICK_S)
                clutch, pose = steer.clutch, caregivers_hand(steer)
            turned = transforms.multiply(pose.q_w, transforms.conjugate(start.q_w))
            room_turned = transforms.multiply(
                transforms.multiply(room_q, turned), transforms.conjugate(room_q)
            )
            self.call_emulator("setSqueeze", "right", clutch)
            self.move(REST_M + transforms.rotate(room_q, pose.pos_w - start.pos_w), room_turned)
            self.wait_for_frames(2)
            pace.until = target = world.ticks + SUBSTEPS
            wait_until(lambda target=target: world.ticks >= target)
            yield
        pace.until = np.inf

    def move(self, position: np.ndarray, q: np.ndarray) -> None:
        w, x, y, z = q.tolist()
        self.call_emulator(
            "setPoses", {"right": {"position": position.tolist(), "orientation": [x, y, z, w]}}
        )


@pytest.mark.slow
def test_a_caregiver_feeds_a_participant_in_the_same_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The recording names who drove each step, and replays bit by bit."""
    pace = Pace(monkeypatch)
    trial = TrialPlan("avrgym/FeedingJaco-v1", "operator", 3, practice=False, questionnaire_items=())
    plan = SessionPlan([trial], "woman", 0.3, is_simulated=True, trial_steps=STEPS, countdown_s=0.3)
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened, width=640, height=360)
        journey.enter()
        caregiver = CaregiversHeadset(journey)
        opened.callback(caregiver.page.close)
        journey.finish_phases(*SEATING)
        session = journey.session
        wait_until(lambda: session.phase_name == "trial")
        for _ in caregiver.feed(pace):
            if not (tmp_path / "caregiver.png").exists() and is_near_mouth(session.world):
                caregiver.pull_trigger("left")
                for name, headset in (("participant", journey.headset), ("caregiver", caregiver)):
                    take_picture(headset, tmp_path / f"{name}.png")
        wait_until(lambda: session.phase_name == "finished")
    recording = read_recording(session.recordings[0])
    steps = [step for _, step in recording.messages_by_topic["/control"]]
    assert steps[-1].success
    assert {step.driver for step in steps if not step.idle} == {"demonstrator"}
    assert result(recording) == "completed"
    assert verify_recording(recording).is_identical
