"""Laws of the conversion between WebXR's and the world's conventions."""

from typing import Literal

import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models.human import HEADSET_OFFSET_M
from avrgym.vr.protocol.messages import TrackingFrameMessage, XRPose
from avrgym.vr.protocol.webxr import (
    Pose,
    Registration,
    compute_hand_pose,
    compute_hand_pose_from_wrist,
    compute_head_pose,
    compute_registration,
    convert_hand_to_grip,
    convert_head_to_headset,
    is_valid_pose,
)
from avrgym.vr.tracking.tracking_frames import compute_body_pose

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
AHEAD_W = [0.0, -1.0, 0.0]


def random_quaternion(rng: np.random.Generator) -> np.ndarray:
    return transforms.normalize(rng.normal(size=4))


def random_registration(rng: np.random.Generator) -> Registration:
    return Registration(np.array([*rng.uniform(-2, 2, 2), 0.0]), float(rng.uniform(-np.pi, np.pi)))


def test_to_world_and_back_is_the_same_pose(rng: np.random.Generator) -> None:
    for _ in range(50):
        registration = random_registration(rng)
        pose = Pose(rng.uniform(-2, 2, 3), random_quaternion(rng))
        again = registration.to_world(registration.from_world(pose))
        np.testing.assert_allclose(again.pos_w, pose.pos_w, atol=1e-12)
        assert transforms.angle_between(again.q_w, pose.q_w) < 1e-7


def test_up_stays_up_and_lengths_stay() -> None:
    registration = Registration(np.array([1.0, 2.0, 0.0]), 0.7)
    low, high = (registration.to_world(XRPose((0.3, y, -0.2), UPRIGHT)) for y in (0.0, 1.5))
    np.testing.assert_allclose(high.pos_w - low.pos_w, [0.0, 0.0, 1.5], atol=1e-12)
    assert low.pos_w[2] == pytest.approx(0.0)


@pytest.mark.parametrize("yaw_rad", np.linspace(-np.pi, np.pi, 9))
def test_registering_puts_the_head_over_the_seat_with_its_gaze_along_minus_y(yaw_rad: float) -> None:
    half = 0.5 * yaw_rad
    head = XRPose((0.4, 1.2, -0.7), (0.0, float(np.sin(half)), 0.0, float(np.cos(half))))
    pose = compute_head_pose(compute_registration(head, np.array([0.0, 0.03, 1.15])), head)
    np.testing.assert_allclose(pose.pos_w, [0.0, 0.03, 1.15], atol=1e-12)
    np.testing.assert_allclose(transforms.rotate(pose.q_w, AHEAD_W), AHEAD_W, atol=1e-12)


@pytest.mark.parametrize("pitch_rad", [-1.0, 0.5])
def test_registering_does_not_mind_a_nod(pitch_rad: float) -> None:
    """Only the gaze's direction over the floor counts."""
    turn = transforms.multiply(
        transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(2.0)),
        transforms.from_axis_angle([1.0, 0.0, 0.0], np.asarray(pitch_rad)),
    )
    w, x, y, z = turn.tolist()
    head = XRPose((0.4, 1.2, -0.7), (x, y, z, w))
    pose = compute_head_pose(compute_registration(head, np.array([0.1, 0.03, 1.2])), head)
    np.testing.assert_allclose(pose.pos_w, [0.1, 0.03, 1.2], atol=1e-12)
    ahead = transforms.rotate(pose.q_w, AHEAD_W)
    np.testing.assert_allclose(ahead, [0.0, -np.cos(pitch_rad), np.sin(pitch_rad)], atol=1e-12)


def test_the_head_lies_behind_the_headset() -> None:
    head = XRPose((0.0, 1.2, 0.0), UPRIGHT)
    registration = compute_registration(head, np.zeros(3))
    headset = registration.to_world(head).pos_w
    np.testing.assert_allclose(
        headset - compute_head_pose(registration, head).pos_w, [0, -HEADSET_OFFSET_M, 0], atol=1e-12
    )


def test_headset_and_grip_are_inverses_of_head_and_hand(rng: np.random.Generator) -> None:
    for to_body, to_device in (
        (compute_head_pose, convert_head_to_headset),
        (compute_hand_pose, convert_hand_to_grip),
    ):
        registration = random_registration(rng)
        body = Pose(rng.uniform(-1, 1, 3), random_quaternion(rng))
        again = to_body(registration, to_device(registration, body))
        np.testing.assert_allclose(again.pos_w, body.pos_w, atol=1e-12)
        assert transforms.angle_between(again.q_w, body.q_w) < 1e-7


def test_a_fist_around_an_upright_rod_has_its_thumb_up() -> None:
    """Of such a grip −z is up and x is right (WebXR ``gripSpace``); the hand's −y is its thumb, −z its knuckles."""
    half = np.sqrt(0.5)
    grip = XRPose((0.0, 1.0, 0.0), (float(half), 0.0, 0.0, float(half)))
    hand = compute_hand_pose(Registration(np.zeros(3), np.pi), grip)
    np.testing.assert_allclose(transforms.rotate(hand.q_w, [0.0, -1.0, 0.0]), [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(transforms.rotate(hand.q_w, [0.0, 0.0, -1.0]), AHEAD_W, atol=1e-12)


@pytest.mark.parametrize("side", ["left", "right"])
def test_a_tracked_hand_on_a_table_points_ahead_with_its_thumb_inward(side: Literal["left", "right"]) -> None:
    """Palm down, fingers ahead: of a wrist −z is ahead and y up; the hand's −z are its fingers, −y is its thumb."""
    wrist = XRPose((0.0, 0.8, 0.0), UPRIGHT)
    hand = compute_hand_pose_from_wrist(Registration(np.zeros(3), np.pi), wrist, side)
    inward = [1.0, 0.0, 0.0] if side == "right" else [-1.0, 0.0, 0.0]
    np.testing.assert_allclose(transforms.rotate(hand.q_w, [0.0, 0.0, -1.0]), AHEAD_W, atol=1e-12)
    np.testing.assert_allclose(hand.pos_w, [0.0, -0.08, 0.8], atol=1e-12)
    np.testing.assert_allclose(transforms.rotate(hand.q_w, [0.0, -1.0, 0.0]), inward, atol=1e-12)


@pytest.mark.parametrize(
    "pose",
    [
        XRPose((float("nan"), 1.0, 0.0), UPRIGHT),
        XRPose((0.0, float("inf"), 0.0), UPRIGHT),
        XRPose((0.0, 1e30, 0.0), UPRIGHT),
        XRPose((0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 0.0)),
        XRPose((0.0, 1.0, 0.0), (0.0, 0.0, 0.0, 1.1)),
        XRPose((0.0, 1.0, 0.0), (0.0, 0.0, float("nan"), 1.0)),
    ],
)
def test_poses_that_no_headset_has_are_not_valid(pose: XRPose) -> None:
    assert not is_valid_pose(pose)
    assert is_valid_pose(XRPose((0.1, 1.2, -0.3), UPRIGHT))


def test_hand_poses_depend_on_their_modality(rng: np.random.Generator) -> None:
    """A controller in one hand while the other is bare."""
    registration, pose = random_registration(rng), XRPose((0.1, 1.0, -0.2), (0.5, -0.5, 0.5, 0.5))
    body = compute_body_pose(
        registration, TrackingFrameMessage(0, 0.0, pose, pose, pose, "hand", "controller")
    )
    assert body.left is not None
    assert body.right is not None
    wrist, grip = (
        compute_hand_pose_from_wrist(registration, pose, "left"),
        compute_hand_pose(registration, pose),
    )
    np.testing.assert_array_equal(body.left.pos_w, wrist.pos_w)
    np.testing.assert_array_equal(body.right.pos_w, grip.pos_w)
