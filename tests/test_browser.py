"""A whole journey in a real browser: headless Chromium with an emulated headset, the real server and physics.

The emulated headset proves logic and protocol; frame rates are never asserted.
"""

import io
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from avrgym import transforms
from avrgym.episodes import EPISODE_STEPS
from avrgym.models import human
from avrgym.participants import SimulatedParticipant, draw_traits
from avrgym.study.questionnaire import LIKERT_ITEMS
from avrgym.study.recording import read_recording
from avrgym.vr.emulation import EmulatedHeadset
from avrgym.vr.messages import Tracking
from avrgym.vr.plan import SessionPlan, TrialPlan, load_policies
from avrgym.vr.server import LiveServer
from avrgym.vr.session import Session
from avrgym.vr.webxr import Registration, hand_pose, head_pose

PATIENCE_S = 90.0
SETTLE_S = 1.5
REACHING_RAD = human.joint_angles(
    waist_x=8.0, waist_y=4.0, head_z=20.0, head_x=5.0,
    right_shoulder_x=-35.0, right_shoulder_y=10.0, right_elbow_x=-70.0, right_wrist_x=10.0,
    left_shoulder_x=-20.0, left_shoulder_y=-15.0, left_elbow_x=-100.0,
)  # fmt: skip


@pytest.fixture(scope="module")
def journey(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[LiveServer, EmulatedHeadset, Path]]:
    folder = tmp_path_factory.mktemp("study")
    plan = SessionPlan(
        [TrialPlan("avrgym/FeedingJaco-v1", "revised", seed=3, practice=False)], "woman", 3.0, simulated=True
    )
    policies = load_policies(plan)
    with (
        LiveServer(lambda send: Session(plan, policies, folder, send, "journey"), "127.0.0.1", 0) as server,
        EmulatedHeadset(server.url, width=320, height=180) as headset,
    ):
        yield server, headset, folder


def test_a_participant_is_seated_fed_and_asked(journey: tuple[LiveServer, EmulatedHeadset, Path]) -> None:
    server, headset, folder = journey
    participant = SimulatedParticipant(draw_traits("woman", 5), 5)
    start = time.monotonic()

    headset.set_poses(participant.frame(0.0, moving=False))
    headset.enter_vr()
    assert headset.call("presenting")
    await_phase(headset, "calibration")
    go_on(headset, "calibration")
    await_phase(headset, "check")
    go_on(headset, "check")
    await_phase(headset, "free_before")
    assert server.session.person.torso_height_m == pytest.approx(participant.traits.torso_height_m, abs=0.005)

    frame = participant.frame_of(REACHING_RAD, 0.0)
    headset.set_poses(frame)
    time.sleep(SETTLE_S)
    registration = server.session.registration
    assert registration is not None
    head_error, hand_errors = errors(headset, server, registration, frame)
    print(
        f"head {1000 * head_error:.1f} mm, hands {[round(1000 * e, 1) for e in hand_errors]} mm from their targets"
    )
    assert head_error < 0.02
    assert max(hand_errors) < 0.03

    await_phase(headset, "trial")
    headset.set_poses(participant.frame(1.0, moving=False))
    left, right = eyes(headset)
    assert (np.abs(left - right).max(axis=-1) > 24).mean() > 0.01
    for eye in (left, right):
        assert len(np.unique((eye // 32).reshape(-1, 3), axis=0)) > 20

    await_phase(headset, "questionnaire")
    given = {}
    for value, item in zip((7, 6, 5, 4), LIKERT_ITEMS, strict=True):
        await_question(headset, item.id)
        headset.answer(value)
        given[item.id] = value
    await_phase(headset, "finished")

    recording = read_recording(folder / "trial-01_attempt-1.mcap")
    assert recording.complete
    assert recording.outcome is not None
    assert recording.outcome["result"] == "completed"
    assert recording.metadata["simulated"] is True
    control = [record for _, record in recording.topics["/control"]]
    assert [record.step for record in control] == list(range(1, EPISODE_STEPS + 1))
    assert {record.item: record.value for _, record in recording.topics["/answers"]} == given
    assert len(recording.topics["/physics"]) >= 10 * EPISODE_STEPS
    assert any(record.applied and record.right is not None for _, record in recording.topics["/tracking"])
    phases = [record.detail for _, record in recording.topics["/events"] if record.name == "phase"]
    assert phases == ["free_before", "countdown", "trial", "free_after", "questionnaire"]
    assert time.monotonic() - start > 0.1 * EPISODE_STEPS


def go_on(headset: EmulatedHeadset, phase: str) -> None:
    """Press the trigger until a phase is over: a slow page may have sent too few frames to be measured by."""
    while headset.call("phase")["name"] == phase:
        headset.await_frames(30)
        headset.pull_trigger("right")


def await_phase(headset: EmulatedHeadset, name: str) -> None:
    headset.page.wait_for_function(
        "([name]) => window.avrgymEmulator.phase()?.name === name", arg=[name], timeout=1000 * PATIENCE_S
    )


def await_question(headset: EmulatedHeadset, item: str) -> None:
    headset.page.wait_for_function(
        "([item]) => window.avrgymEmulator.question()?.item === item && window.avrgymEmulator.buttons().length",
        arg=[item],
        timeout=1000 * PATIENCE_S,
    )


def errors(
    headset: EmulatedHeadset, server: LiveServer, registration: Registration, frame: Tracking
) -> tuple[float, list[float]]:
    """How far the simulated head and hands are from where headset and controllers put them, metres."""
    assert frame.head is not None
    assert frame.left is not None
    assert frame.right is not None
    person = server.session.person
    layout = human.layout(np.array([person.sex == "woman"]), np.array([person.torso_height_m]))
    bodies = server.session.bodies
    poses = np.reshape(headset.call("lastState")["poses"], (len(bodies), 7))

    def site(name: str) -> np.ndarray:
        pose = poses[bodies.index(human.PREFIX + human.SITE_BODY[name])]
        return pose[:3] + transforms.rotate(pose[3:], layout.site_pos[name][0])

    head = np.linalg.norm(site("head_centre") - head_pose(registration, frame.head).pos_w)
    hands = [
        float(np.linalg.norm(site(f"{side}_hand_centre") - hand_pose(registration, grip).pos_w))
        for side, grip in (("left", frame.left), ("right", frame.right))
    ]
    return float(head), hands


def eyes(headset: EmulatedHeadset) -> tuple[np.ndarray, np.ndarray]:
    picture = np.asarray(Image.open(io.BytesIO(headset.page.screenshot())).convert("RGB")).astype(int)
    middle = picture.shape[1] // 2
    return picture[:, :middle], picture[:, middle : 2 * middle]
