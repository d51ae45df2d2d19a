"""A whole journey in a real browser: headless Chromium with an emulated headset, the real server and physics.

The emulated headset proves logic and protocol; frame rates are never asserted.
"""

import io
import operator
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest
from PIL import Image

from avrgym.geometry import transforms
from avrgym.models import human, robot
from avrgym.models.furniture.real_furniture import RealFurniture
from avrgym.questionnaires.questionnaire import LIKERT_ITEMS
from avrgym.recording.reader import read_recording
from avrgym.vr.emulation.emulated_headset import DONE_BUTTON_VALUE, EmulatedHeadset
from avrgym.vr.protocol.messages import TrackingFrameMessage
from avrgym.vr.protocol.webxr import (
    Pose,
    Registration,
    compute_hand_pose,
    compute_head_pose,
    convert_hand_to_grip,
)
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.session.session import Session
from helpers.browser.journey import Journey, draw_triangles, wait_until

pytestmark = pytest.mark.usefixtures("relaxed_limits")

TRIAL_STEPS = 100
REACHING_RAD = human.make_seated_joint_angles(
    waist_x=8.0, waist_y=4.0, head_z=20.0, head_x=5.0,
    right_shoulder_x=-35.0, right_shoulder_y=10.0, right_elbow_x=-70.0, right_wrist_x=10.0,
    left_shoulder_x=-20.0, left_shoulder_y=-15.0, left_elbow_x=-100.0,
)  # fmt: skip


@pytest.fixture
def journey(tmp_path: Path) -> Iterator[Journey]:
    trial = TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 2.0, is_simulated=True, trial_steps=TRIAL_STEPS)
    with ExitStack() as opened:
        yield Journey(tmp_path, plan, load_policies(plan), opened)


@pytest.mark.slow
def test_a_participant_completes_a_feeding_session(journey: Journey) -> None:
    headset, session = journey.headset, journey.session
    journey.enter()
    assert headset.call_emulator("presenting")
    journey.calibrate()
    journey.wait_for_phase("free_before")
    assert session.person.torso_height_m == pytest.approx(
        journey.participant.traits.torso_height_m, abs=0.005
    )

    frame = journey.participant.make_tracking_frame_from_angles(REACHING_RAD, 0.0)
    headset.set_poses(frame)
    registration = session.registration
    assert registration is not None
    wait_until(lambda: all(map(operator.lt, errors(journey, registration, frame), (0.02, 0.03, 0.03))))

    journey.wait_for_phase("trial")
    headset.set_poses(journey.participant.make_tracking_frame(1.0, moving=False))
    left, right = eyes(headset)
    assert (np.abs(left - right).max(axis=-1) > 24).mean() > 0.01
    for eye in (left, right):
        assert len(np.unique((eye // 32).reshape(-1, 3), axis=0)) > 20

    given = {}
    for value, item in zip((7, 6, 5, 4), LIKERT_ITEMS, strict=True):
        journey.wait_for_buttons(item.id)
        headset.select_answer(value)
        given[item.id] = value
    journey.wait_for_buttons("confirm")
    headset.select_answer(DONE_BUTTON_VALUE)
    journey.wait_for_phase("finished")

    recording = read_recording(journey.folder / "trial-01_attempt-1.mcap")
    assert recording.is_complete
    assert recording.outcome is not None
    assert recording.outcome.result == "completed"
    assert recording.configuration.simulated is True
    control = [record for _, record in recording.messages_by_topic["/control"]]
    assert [record.step for record in control] == list(range(1, TRIAL_STEPS + 1))
    assert {record.item: record.value for _, record in recording.messages_by_topic["/answers"]} == given
    assert len(recording.messages_by_topic["/physics"]) >= 10 * TRIAL_STEPS
    assert any(
        record.moved_person and record.right is not None
        for _, record in recording.messages_by_topic["/tracking"]
    )
    phases = [record.detail for _, record in recording.messages_by_topic["/events"] if record.name == "phase"]
    assert phases == [
        "free_before",
        "countdown",
        "trial",
        "retreat",
        "free_after",
        "questionnaire",
        "confirm",
    ]


@pytest.mark.slow
@pytest.mark.parametrize("seat_height_m", [0.45, 0.52])
def test_the_same_person_is_as_tall_on_any_chair(tmp_path: Path, seat_height_m: float) -> None:
    """The height of the chair is an option, and is stored in the recording."""
    furniture = RealFurniture(seat_height_m=seat_height_m)
    trial = TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)
    plan = SessionPlan(
        [trial], "woman", 0.5, is_simulated=True, trial_steps=1, questionnaire_items=(), furniture=furniture
    )
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        journey.enter()
        journey.calibrate()
        journey.wait_for_phase("finished")
        traits, person = journey.participant.traits, journey.session.person
    assert person.torso_height_m == pytest.approx(traits.torso_height_m, abs=0.005)
    kept = read_recording(tmp_path / "trial-01_attempt-1.mcap").configuration
    assert kept.furniture.seat_height_m == seat_height_m
    assert kept.goal == "Eat the food from the spoon."


NEAR_M, NEAR_DEG = 0.01, 3.0
STEP_M = 0.03


@pytest.mark.slow
def test_hands_are_drawn_without_latency_and_blocked_by_the_robot(tmp_path: Path) -> None:
    """Even while the server stands still; but where the robot is in the way, a hand is drawn where it touches."""
    trial = TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 600.0, is_simulated=True, trial_steps=1)
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        journey.enter()
        journey.calibrate()
        journey.wait_for_phase("free_before")
        wait_until(lambda: OwnHand(journey).drawn_off_m < NEAR_M)

        with standing_still(journey.session):
            for share in np.linspace(0.2, 1.0, 5):
                angles = human.SEATED_POSE_RAD + share * (REACHING_RAD - human.SEATED_POSE_RAD)
                journey.headset.set_poses(journey.participant.make_tracking_frame_from_angles(angles, 0.0))
                journey.headset.wait_for_frames(1)
                hand = OwnHand(journey)
                assert hand.drawn_off_m < NEAR_M
                assert hand.drawn_off_deg < NEAR_DEG
            assert hand.simulated_off_m > 10.0 * NEAR_M

        frame = journey.participant.make_tracking_frame_from_angles(REACHING_RAD, 0.0)
        assert frame.right is not None
        registration = journey.session.registration
        assert registration is not None
        start_w = compute_hand_pose(registration, frame.right).pos_w
        goal_w = nearest_of_robot(journey, start_w)
        way = np.linspace(start_w, goal_w, 2 + int(np.linalg.norm(goal_w - start_w) / STEP_M))
        for place_w in way:
            grip = convert_hand_to_grip(
                registration, Pose(place_w, compute_hand_pose(registration, frame.right).q_w)
            )
            journey.headset.set_poses(msgspec.structs.replace(frame, right=grip))
            journey.headset.wait_for_frames(2)
        wait_until(lambda: OwnHand(journey).held)
        journey.headset.set_poses(frame)
        wait_until(lambda: OwnHand(journey).drawn_off_m < NEAR_M)


@contextmanager
def standing_still(session: Session) -> Iterator[None]:
    """The session does not tick meanwhile."""
    going_on, tick = threading.Event(), session.tick

    def wait_and_tick(now_s: float) -> None:
        going_on.wait()
        tick(now_s)

    session.tick = wait_and_tick
    try:
        yield
    finally:
        going_on.set()
        session.tick = tick


class OwnHand:
    """The right hand in the frame that the page drew last: how far it is drawn, and simulated, from its controller."""

    def __init__(self, journey: Journey) -> None:
        own, self._session = journey.headset.call_emulator("participantBody"), journey.session
        tracked = own["tracked"]["right"]
        drawn_w, drawn_q = self._hand(own["drawn"])
        simulated_w, _ = self._hand(own["simulated"])
        self.drawn_off_m = float(np.linalg.norm(drawn_w - tracked["position"]))
        self.drawn_off_deg = float(np.degrees(transforms.angle_between(drawn_q, np.array(tracked["q"]))))
        self.simulated_off_m = float(np.linalg.norm(simulated_w - tracked["position"]))
        self.drawn_from_simulated_m = float(np.linalg.norm(drawn_w - simulated_w))

    @property
    def held(self) -> bool:
        """Whether it is drawn where it is simulated, farther from its controller than hands are in free movement."""
        return self.drawn_from_simulated_m < NEAR_M < self.drawn_off_m - NEAR_M

    def _hand(self, poses: list[float]) -> tuple[np.ndarray, np.ndarray]:
        name = human.PERSON_NAME_PREFIX + "right_hand"
        pose = np.reshape(poses, (-1, 7))[self._session.bodies.index(name)]
        centre = [0.0, 0.0, -self._session.world.skeleton.hand_m]
        return pose[:3] + transforms.rotate(pose[3:], centre), pose[3:]


def nearest_of_robot(journey: Journey, place_w: np.ndarray) -> np.ndarray:
    """Where the body of the robot is that is nearest to a place."""
    poses = np.reshape(journey.headset.call_emulator("lastState")["poses"], (-1, 7))
    bodies = journey.session.bodies
    places = [
        pose[:3]
        for name, pose in zip(bodies, poses, strict=False)
        if name.startswith(robot.ROBOT_NAME_PREFIX)
    ]
    return min(places, key=lambda pos_w: float(np.linalg.norm(pos_w - place_w)))


def errors(
    journey: Journey, registration: Registration, frame: TrackingFrameMessage
) -> tuple[float, float, float]:
    """How far the simulated head, left and right hand are from where headset and controllers put them, metres."""
    assert frame.head is not None
    assert frame.left is not None
    assert frame.right is not None
    person = journey.session.person
    layout = human.compute_body_layout(np.array([person.sex == "woman"]), np.array([person.torso_height_m]))
    bodies = journey.session.bodies
    poses = np.reshape(journey.headset.call_emulator("lastState")["poses"], (len(bodies), 7))

    def site(name: str) -> np.ndarray:
        pose = poses[bodies.index(human.PERSON_NAME_PREFIX + human.SITE_BODIES[name])]
        return pose[:3] + transforms.rotate(pose[3:], layout.site_pos[name][0])

    wanted = (
        compute_head_pose(registration, frame.head),
        compute_hand_pose(registration, frame.left),
        compute_hand_pose(registration, frame.right),
    )
    sites = ("head_centre", "left_hand_centre", "right_hand_centre")
    head, left, right = (
        float(np.linalg.norm(site(name) - pose.pos_w)) for name, pose in zip(sites, wanted, strict=True)
    )
    return head, left, right


def eyes(headset: EmulatedHeadset) -> tuple[np.ndarray, np.ndarray]:
    """What each eye sees, (H, W, 3)."""
    draw_triangles(headset)
    picture = np.asarray(Image.open(io.BytesIO(headset.page.screenshot())).convert("RGB")).astype(int)
    middle = picture.shape[1] // 2
    return picture[:, :middle], picture[:, middle : 2 * middle]
