import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import (
    JOINT_INDEX,
    JOINTS,
    LOWER_LIMITS_RAD,
    UPPER_LIMITS_RAD,
    People,
    Person,
    make_seated_joint_angles,
)
from avrgym.people import shoulder_limits
from avrgym.people.shoulder_limits import are_shoulders_within_limits, clip_shoulders

SHOULDER = [JOINT_INDEX[f"{side}_shoulder_{axis}"] for side in ("right", "left") for axis in "yxz"]


@pytest.fixture
def poses(rng) -> np.ndarray:
    """Poses (20000, 20) from all over the joints' ranges."""
    return rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, (20_000, len(JOINTS)))


def mirror(angles: np.ndarray) -> np.ndarray:
    """The mirror image of poses: turns about x stay, others change sign, right becomes left."""
    mirrored = np.empty_like(angles)
    for column, name in enumerate(JOINTS):
        side, _, part = name.partition("_")
        other = {"right": f"left_{part}", "left": f"right_{part}"}.get(side, name)
        mirrored[..., JOINT_INDEX[other]] = (1.0 if name.endswith("x") else -1.0) * angles[..., column]
    return mirrored


def hands(**degrees: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the right and the left hand of the seated man are, each (3,)."""
    pos_w, _ = human.compute_body_frames(
        People.from_persons([Person("man", 0.6, make_seated_joint_angles(**degrees))])
    )
    return pos_w["right_hand"][0], pos_w["left_hand"][0]


def shoulder_deg(pose: np.ndarray) -> np.ndarray:
    """Right y, x, z and left y, x, z in degrees."""
    return np.degrees(pose[..., SHOULDER])


# Laws


def test_clipped_poses_are_possible_and_within_the_joints_ranges(poses):
    clipped = clip_shoulders(poses)
    assert are_shoulders_within_limits(clipped).all()
    assert ((clipped >= LOWER_LIMITS_RAD) & (clipped <= UPPER_LIMITS_RAD)).all()


def test_clipping_twice_is_clipping_once(poses):
    once = clip_shoulders(poses)
    assert_array_equal(clip_shoulders(once), once)


def test_only_impossible_poses_change(poses):
    poses = np.concatenate([poses, clip_shoulders(poses)])
    unchanged = (clip_shoulders(poses) == poses).all(axis=-1)
    assert_array_equal(unchanged, are_shoulders_within_limits(poses))
    assert 0.4 < unchanged.mean() < 0.6


def test_only_shoulders_move(poses):
    others = [column for column in range(len(JOINTS)) if column not in SHOULDER]
    assert_array_equal(clip_shoulders(poses)[:, others], poses[:, others])


def test_the_mirror_image_has_the_same_limits(poses):
    poses[::2] = clip_shoulders(poses[::2])
    assert_array_equal(are_shoulders_within_limits(mirror(poses)), are_shoulders_within_limits(poses))
    assert_array_equal(clip_shoulders(mirror(poses)), mirror(clip_shoulders(poses)))


def test_each_pose_is_clipped_independently(poses):
    assert_array_equal(clip_shoulders(poses)[7], clip_shoulders(poses[7]))
    assert_array_equal(
        clip_shoulders(poses[:50].reshape(5, 10, -1)).reshape(50, -1), clip_shoulders(poses)[:50]
    )
    assert are_shoulders_within_limits(poses[7]) == are_shoulders_within_limits(poses)[7]


def test_the_input_pose_does_not_change(poses):
    before = poses.copy()
    clip_shoulders(poses)
    assert_array_equal(poses, before)


def test_every_abduction_and_flexion_leaves_room_to_turn():
    abduction = np.linspace(*shoulder_limits.ABDUCTION_RANGE_RAD, 200)[:, None]
    low, high = shoulder_limits.compute_flexion_range_rad(abduction)
    internal, external = shoulder_limits.compute_rotation_range_rad(
        abduction, low + (high - low) * np.linspace(0, 1, 200)
    )
    assert (high - low > np.radians(100.0)).all()
    assert (external - internal > np.radians(15.0)).all()


# Meaning


def test_angles_follow_anatomical_conventions():
    """Abduction, flexion and external rotation move the hand out, forward and out, on both sides."""
    right, left = hands()
    out_right, out_left = hands(right_shoulder_y=40.0, left_shoulder_y=-40.0)
    assert out_right[0] < right[0]
    assert out_left[0] > left[0]
    forward_right, forward_left = hands(right_shoulder_x=-40.0, left_shoulder_x=-40.0)
    assert forward_right[1] < right[1]
    assert forward_left[1] < left[1]
    turned_right, turned_left = hands(right_shoulder_z=-40.0, left_shoulder_z=40.0)
    assert turned_right[0] < right[0]
    assert turned_left[0] > left[0]


@pytest.mark.parametrize(
    ("degrees", "expected"),
    [
        ({"right_shoulder_y": -30.0}, (-9.0, 0.0, 0.0)),
        ({"right_shoulder_y": 190.0, "right_shoulder_x": -60.0}, (160.0, -60.0, -51.4815)),
        ({"right_shoulder_x": 60.0}, (0.0, 43.0, 0.0)),
        ({"right_shoulder_x": -180.0, "right_shoulder_z": 20.0}, (0.0, -153.0, 25.0)),
        ({"right_shoulder_z": -90.0}, (0.0, 0.0, -60.0)),
        ({"right_shoulder_z": 90.0}, (0.0, 0.0, 90.0)),
        ({"right_shoulder_y": 90.0, "right_shoulder_z": 90.0}, (90.0, 0.0, 20.0)),
        ({"right_shoulder_x": -90.0, "right_shoulder_z": -90.0}, (0.0, -90.0, -10.0)),
    ],
)
def test_limits_match_values_computed_by_hand(degrees, expected):
    assert_allclose(
        shoulder_deg(clip_shoulders(make_seated_joint_angles(**degrees)))[:3], expected, atol=1e-3
    )


@pytest.mark.parametrize("rotation", [-90.0, 90.0])
def test_limits_are_constant_where_two_axes_coincide(rotation):
    """At a flexion of 90° abduction and axial rotation turn the arm about the same line."""
    abductions = [15.0, 30.0, 45.0, 60.0, 75.0]
    poses = np.stack(
        [
            make_seated_joint_angles(right_shoulder_y=a, right_shoulder_x=-90.0, right_shoulder_z=rotation)
            for a in abductions
        ]
    )
    people = People.make_unimpaired(np.full(5, False), np.full(5, 0.6), clip_shoulders(poses))
    q_w = human.compute_body_frames(people)[1]["right_upper_arm"]
    assert_allclose(transforms.angle_between(q_w[:1], q_w), 0.0, atol=1e-7)


# The poses in which tasks find people


def spread(rng, **degrees: float) -> np.ndarray:
    """Poses (4000, 20): the named angles in degrees, ± 10° in every joint of the right arm."""
    pose = np.tile(make_seated_joint_angles(**degrees), (4000, 1))
    arm = [column for name, column in JOINT_INDEX.items() if name.startswith("right")]
    pose[:, arm] += np.radians(rng.uniform(-10.0, 10.0, (4000, len(arm))))
    return np.clip(pose, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD)


BED = {
    "right_shoulder_y": 20.0, "left_shoulder_y": -20.0, "right_shoulder_x": -20.0, "left_shoulder_x": -20.0,
    "right_elbow_x": -45.0, "left_elbow_x": -45.0,
}  # fmt: skip


@pytest.mark.parametrize("degrees", [{"right_shoulder_y": 30.0}, BED])
def test_poses_for_scratching_and_bathing_are_all_possible(rng, degrees):
    assert are_shoulders_within_limits(spread(rng, **degrees)).all()


def test_of_poses_about_the_seated_one_only_arms_pressed_inward_are_impossible(rng):
    poses = spread(rng)
    assert are_shoulders_within_limits(make_seated_joint_angles())
    pressed = shoulder_deg(poses)[:, 0] < -9.0
    assert_array_equal(are_shoulders_within_limits(poses), ~pressed)
    assert 0.03 < pressed.mean() < 0.07
