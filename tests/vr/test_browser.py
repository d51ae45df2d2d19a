"""A whole journey in a real browser: headless Chromium with an emulated headset, the real server and physics.

The emulated headset proves logic and protocol; frame rates are never asserted.
"""

import io
import operator
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.furniture.real import RealFurniture
from avrgym.recording.files import read_recording
from avrgym.recording.questionnaire import LIKERT_ITEMS
from avrgym.vr.emulation.headset import EmulatedHeadset
from avrgym.vr.protocol.messages import Tracking
from avrgym.vr.protocol.webxr import Registration, hand_pose, head_pose
from avrgym.vr.session.plan import SessionPlan, TrialPlan, load_policies
from journey import Journey, await_that

pytestmark = pytest.mark.usefixtures("unhurried")

TRIAL_STEPS = 100
REACHING_RAD = human.joint_angles(
    waist_x=8.0, waist_y=4.0, head_z=20.0, head_x=5.0,
    right_shoulder_x=-35.0, right_shoulder_y=10.0, right_elbow_x=-70.0, right_wrist_x=10.0,
    left_shoulder_x=-20.0, left_shoulder_y=-15.0, left_elbow_x=-100.0,
)  # fmt: skip


@pytest.fixture
def journey(tmp_path: Path) -> Iterator[Journey]:
    trial = TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 2.0, simulated=True, trial_steps=TRIAL_STEPS)
    with ExitStack() as opened:
        yield Journey(tmp_path, plan, load_policies(plan), opened)


def test_a_participant_is_seated_fed_and_asked(journey: Journey) -> None:
    headset, session = journey.headset, journey.session
    journey.enter()
    assert headset.call("presenting")
    journey.be_seated()
    journey.await_phase("free_before")
    assert session.person.torso_height_m == pytest.approx(
        journey.participant.traits.torso_height_m, abs=0.005
    )

    frame = journey.participant.frame_of(REACHING_RAD, 0.0)
    headset.set_poses(frame)
    registration = session.registration
    assert registration is not None
    await_that(lambda: all(map(operator.lt, errors(journey, registration, frame), (0.02, 0.03, 0.03))))

    journey.await_phase("trial")
    headset.set_poses(journey.participant.frame(1.0, moving=False))
    left, right = eyes(headset)
    assert (np.abs(left - right).max(axis=-1) > 24).mean() > 0.01
    for eye in (left, right):
        assert len(np.unique((eye // 32).reshape(-1, 3), axis=0)) > 20

    given = {}
    for value, item in zip((7, 6, 5, 4), LIKERT_ITEMS, strict=True):
        journey.await_buttons(item.id)
        headset.answer(value)
        given[item.id] = value
    journey.await_phase("finished")

    recording = read_recording(journey.folder / "trial-01_attempt-1.mcap")
    assert recording.complete
    assert recording.outcome is not None
    assert recording.outcome["result"] == "completed"
    assert recording.metadata["simulated"] is True
    control = [record for _, record in recording.topics["/control"]]
    assert [record.step for record in control] == list(range(1, TRIAL_STEPS + 1))
    assert {record.item: record.value for _, record in recording.topics["/answers"]} == given
    assert len(recording.topics["/physics"]) >= 10 * TRIAL_STEPS
    assert any(record.applied and record.right is not None for _, record in recording.topics["/tracking"])
    phases = [record.detail for _, record in recording.topics["/events"] if record.name == "phase"]
    assert phases == ["free_before", "countdown", "trial", "retreat", "free_after", "questionnaire"]


@pytest.mark.parametrize("seat_height_m", [0.45, 0.52])
def test_the_same_person_is_as_tall_on_any_chair(tmp_path: Path, seat_height_m: float) -> None:
    """The chair's height is told, and kept with the recording."""
    furniture = RealFurniture(seat_height_m=seat_height_m)
    trial = TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)
    plan = SessionPlan([trial], "woman", 0.5, simulated=True, trial_steps=1, items=(), furniture=furniture)
    with ExitStack() as opened:
        journey = Journey(tmp_path, plan, load_policies(plan), opened)
        journey.enter()
        journey.be_seated()
        journey.await_phase("finished")
        traits, person = journey.participant.traits, journey.session.person
    assert person.torso_height_m == pytest.approx(traits.torso_height_m, abs=0.005)
    kept = read_recording(tmp_path / "trial-01_attempt-1.mcap").metadata
    assert kept["furniture"]["seat_height_m"] == seat_height_m
    assert kept["goal"] == "Eat the food from the spoon."


def errors(journey: Journey, registration: Registration, frame: Tracking) -> tuple[float, float, float]:
    """How far the simulated head, left and right hand are from where headset and controllers put them, metres."""
    assert frame.head is not None
    assert frame.left is not None
    assert frame.right is not None
    person = journey.session.person
    layout = human.layout(np.array([person.sex == "woman"]), np.array([person.torso_height_m]))
    bodies = journey.session.bodies
    poses = np.reshape(journey.headset.call("lastState")["poses"], (len(bodies), 7))

    def site(name: str) -> np.ndarray:
        pose = poses[bodies.index(human.PREFIX + human.SITE_BODY[name])]
        return pose[:3] + transforms.rotate(pose[3:], layout.site_pos[name][0])

    wanted = (
        head_pose(registration, frame.head),
        hand_pose(registration, frame.left),
        hand_pose(registration, frame.right),
    )
    sites = ("head_centre", "left_hand_centre", "right_hand_centre")
    head, left, right = (
        float(np.linalg.norm(site(name) - pose.pos_w)) for name, pose in zip(sites, wanted, strict=True)
    )
    return head, left, right


def eyes(headset: EmulatedHeadset) -> tuple[np.ndarray, np.ndarray]:
    picture = np.asarray(Image.open(io.BytesIO(headset.page.screenshot())).convert("RGB")).astype(int)
    middle = picture.shape[1] // 2
    return picture[:, :middle], picture[:, middle : 2 * middle]
