"""Laws of the inverse kinematics from head and hands to the joints of the simulated body."""

import itertools

import mujoco
import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import (
    JOINTS,
    LOWER_LIMITS_RAD,
    RECLINED_POSTURE,
    SEATED_POSE_RAD,
    SEATED_POSTURE,
    SEXES,
    UPPER_LIMITS_RAD,
    Person,
    Posture,
)
from avrgym.vr.protocol.webxr import Pose
from avrgym.vr.tracking.body import (
    RELAXED_JOINT_ANGLES_RAD,
    BodyPose,
    BodySolver,
    compute_hips_frame,
    compute_resting_head_centre,
    solve_torso_angles,
)

MIRROR = np.array([-1.0 if name.endswith(("_y", "_z")) else 1.0 for name in JOINTS])
LEFT_RIGHT = [list(JOINTS).index(_swapped) for _swapped in (
    name.replace("right_", "*").replace("left_", "right_").replace("*", "left_") for name in JOINTS
)]  # fmt: skip
CONVERGED_FRAMES = 80
POSTURES = (SEATED_POSTURE, RECLINED_POSTURE)
WORKING_RAD = np.radians([5, 5, 5, 15, 10, 20, *[10, 20, 20, 25, 20, 10, 10] * 2])
"""How far from the seated pose people move who sit at a table."""


class Skeleton:
    """Forward kinematics of a person, to make poses and to measure what the solver did."""

    def __init__(self, person: Person, posture: Posture = SEATED_POSTURE) -> None:
        self.model = human.compile_person_model(person, posture, moving=True)
        self.data = mujoco.MjData(self.model)

    def pose(self, angles_rad: np.ndarray) -> BodyPose:
        self.data.qpos[:] = angles_rad
        mujoco.mj_kinematics(self.model, self.data)
        head, left, right = (
            Pose(
                self.data.site(f"{human.PERSON_NAME_PREFIX}{site}").xpos.copy(),
                transforms.normalize(self.data.body(f"{human.PERSON_NAME_PREFIX}{body}").xquat),
            )
            for site, body in (
                ("head_centre", "head"), ("left_hand_centre", "left_hand"), ("right_hand_centre", "right_hand"),
            )
        )  # fmt: skip
        return BodyPose(head, left, right)


def distance(a: Pose | None, b: Pose | None) -> float:
    assert a is not None
    assert b is not None
    return float(np.linalg.norm(a.pos_w - b.pos_w))


def turn_deg(a: Pose | None, b: Pose | None) -> float:
    assert a is not None
    assert b is not None
    return float(np.degrees(transforms.angle_between(a.q_w, b.q_w)))


def mirrored(pose: Pose) -> Pose:
    w, x, y, z = pose.q_w
    return Pose(pose.pos_w * [-1, 1, 1], np.array([w, x, -y, -z]))


def resting(person: Person, posture: Posture) -> Pose:
    """The head of a person who rests."""
    _, axes_w = compute_hips_frame(person, posture)
    return Pose(compute_resting_head_centre(person, posture), transforms.from_matrix(axes_w))


def working_poses(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    poses = SEATED_POSE_RAD + WORKING_RAD * rng.uniform(-1, 1, (count, len(JOINTS)))
    poses[:, list(JOINTS).index("waist_z")] = 0.0
    return list(np.clip(poses, LOWER_LIMITS_RAD, UPPER_LIMITS_RAD))


@pytest.mark.parametrize("sex", SEXES)
@pytest.mark.parametrize("height_m", [0.46, 0.54, 0.66])
def test_upright_gives_zero(sex: human.Sex, height_m: float) -> None:
    person = Person(sex, height_m)
    for posture in POSTURES:
        np.testing.assert_allclose(
            solve_torso_angles(person, resting(person, posture), posture), 0.0, atol=1e-9
        )


@pytest.mark.parametrize("posture", POSTURES)
@pytest.mark.parametrize("sex", SEXES)
def test_head_and_hands_come_to_where_they_are(
    sex: human.Sex, posture: Posture, rng: np.random.Generator
) -> None:
    person = Person(sex, 0.56)
    skeleton, solver = Skeleton(person, posture), BodySolver(person, posture)
    for wanted_rad in working_poses(rng, 6):
        wanted = skeleton.pose(wanted_rad)
        angles = SEATED_POSE_RAD
        for _ in range(CONVERGED_FRAMES):
            angles = solver.solve(wanted, angles)
        reached = skeleton.pose(angles)
        assert distance(reached.head_pose, wanted.head_pose) < 0.001
        assert turn_deg(reached.head_pose, wanted.head_pose) < 0.1
        for hand, target in ((reached.left, wanted.left), (reached.right, wanted.right)):
            assert distance(hand, target) < 0.002
            assert turn_deg(hand, target) < 1.0


def test_the_head_follows_leans_along_the_arc_of_a_rigid_torso() -> None:
    person = Person("man", 0.60)
    skeleton, solver = Skeleton(person), BodySolver(person)
    for forward_deg in (-25.0, 10.0, 30.0):
        for sideways_deg in (-25.0, 0.0, 25.0):
            wanted = skeleton.pose(human.make_seated_joint_angles(waist_x=forward_deg, waist_y=sideways_deg))
            reached = skeleton.pose(solver.solve(wanted, SEATED_POSE_RAD))
            assert distance(reached.head_pose, wanted.head_pose) < 1e-6


WOMAN = Person("woman", 0.54)
WAIST_TO_HEAD_M = 0.54 - 0.075
"""The waist joints lie 7.5 cm above the hips."""


def head_error_m(head: Pose) -> float:
    angles = BodySolver(WOMAN).solve(BodyPose(head, None, None), SEATED_POSE_RAD)
    return distance(Skeleton(WOMAN).pose(angles).head_pose, head)


def lean(direction_deg: float, shift_m: float, radius_m: float) -> Pose:
    """The head after leaning, rigid with the torso, about a point ``radius_m`` below its centre.

    0° is forward, 90° to the left.
    """
    heading = np.radians(direction_deg)
    axis = np.array([np.cos(heading), np.sin(heading), 0.0])
    q = transforms.from_axis_angle(axis, np.arcsin(shift_m / radius_m))
    pivot = compute_resting_head_centre(WOMAN, SEATED_POSTURE) - [0.0, 0.0, radius_m]
    return Pose(pivot + transforms.rotate(q, [0.0, 0.0, radius_m]), q)


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("direction_deg", range(0, 360, 15))
def test_leans_about_the_waist_are_followed_as_far_as_it_bends(direction_deg: int) -> None:
    """30 cm forward; to the sides and back the waist's 30° end at 23 cm. The head may look where it likes."""
    farthest_m = 0.30 if direction_deg in (0, 345, 15) else 0.21
    for shift_m in np.linspace(0.03, farthest_m, 4):
        leant = lean(direction_deg, shift_m, WAIST_TO_HEAD_M)
        assert head_error_m(leant) < 0.001
        neck_w = leant.pos_w - transforms.rotate(leant.q_w, [0.0, 0.0, 0.063])
        level = Pose(neck_w + np.array([0.0, 0.0, 0.063]), transforms.IDENTITY_QUATERNION)
        assert head_error_m(level) < 0.001


@pytest.mark.parametrize("posture", POSTURES)
def test_the_head_keeps_its_direction_where_the_waist_cannot_follow(posture: Posture) -> None:
    """The waist ends at 30°; what it leaves over of the head's turn the head's own joints take."""
    skeleton = Skeleton(WOMAN, posture)
    rest = resting(WOMAN, posture)
    for sideways_m in (-0.35, 0.35):
        for yaw in (-0.5, 0.0, 0.5):
            turned = transforms.multiply(rest.q_w, transforms.from_axis_angle(human.Z_AXIS, np.asarray(yaw)))
            head = Pose(rest.pos_w + np.array([sideways_m, 0.0, -0.05]), turned)
            angles = BodySolver(WOMAN, posture).solve(BodyPose(head, None, None), SEATED_POSE_RAD)
            assert angles[1] == pytest.approx(np.sign(sideways_m) * np.radians(30.0))
            assert turn_deg(skeleton.pose(angles).head_pose, head) < 0.01


def test_leans_about_the_hips_are_followed_within_one_and_a_half_centimetres() -> None:
    """People bend at the hips too; the model's waist lies higher, so its arc is shorter."""
    assert head_error_m(lean(0.0, 0.2, 0.54)) < 0.007
    assert head_error_m(lean(0.0, 0.3, 0.54)) < 0.015


@pytest.mark.parametrize(("shift_m", "error_m"), [(0.1, 0.012), (0.2, 0.047), (0.3, 0.100)])
def test_a_head_that_shifts_level_is_out_of_reach_of_a_torso_that_cannot_stretch(
    shift_m: float, error_m: float
) -> None:
    shifted = compute_resting_head_centre(WOMAN, SEATED_POSTURE) - np.array([0.0, shift_m, 0.0])
    head = Pose(shifted, transforms.IDENTITY_QUATERNION)
    assert head_error_m(head) == pytest.approx(error_m, abs=0.001)


@pytest.mark.slow
def test_no_rigid_torso_that_keeps_the_heads_direction_comes_nearer(rng: np.random.Generator) -> None:
    """The head is missed only by what the head joints are farther from the waist, or nearer, than the torso is long."""
    waist_w = compute_resting_head_centre(WOMAN, SEATED_POSTURE) - [0.0, 0.0, WAIST_TO_HEAD_M]
    for _ in range(100):
        q_w = transforms.from_rotation_vector(rng.uniform(-0.1, 0.1, 3))
        head = Pose(
            compute_resting_head_centre(WOMAN, SEATED_POSTURE)
            + rng.uniform(-1.0, 1.0, 3) * [0.12, 0.12, 0.05],
            q_w,
        )
        joints_w = head.pos_w - transforms.rotate(q_w, [0.0, 0.0, 0.063])
        missing_m = np.linalg.norm(joints_w - waist_w) - (WAIST_TO_HEAD_M - 0.063)
        assert head_error_m(head) == pytest.approx(abs(missing_m), abs=1e-6)


def test_waist_and_head_share_the_yaw_three_to_seven() -> None:
    person = Person("woman", 0.54)
    yaw = transforms.from_axis_angle(human.Z_AXIS, np.asarray(0.5))
    angles = solve_torso_angles(
        person, Pose(compute_resting_head_centre(person, SEATED_POSTURE), yaw), SEATED_POSTURE
    )
    np.testing.assert_allclose(angles[[2, 5]], [0.15, 0.35], atol=1e-9)


def test_no_frame_makes_a_joint_of_an_arm_jump(rng: np.random.Generator) -> None:
    person = Person("woman", 0.54)
    skeleton, solver = Skeleton(person), BodySolver(person)
    angles = SEATED_POSE_RAD
    for wanted_rad in working_poses(rng, 10):
        before = angles
        angles = solver.solve(skeleton.pose(wanted_rad), before)
        assert np.abs(angles - before)[6:].max() <= 0.1


def both_arms(**degrees: float) -> np.ndarray:
    """A pose of the right arm, its mirror image for the left, and other joints as named."""
    pose = dict(degrees)
    for name in degrees:
        if name.startswith("right_"):
            sign = 1.0 if name.endswith("x") else -1.0
            pose[name.replace("right", "left")] = sign * degrees[name]
    return human.make_seated_joint_angles(**pose)


JOURNEY = (
    RELAXED_JOINT_ANGLES_RAD,
    both_arms(
        right_shoulder_y=15, right_shoulder_x=10, right_elbow_x=-85, right_forearm_z=-20
    ),  # on armrests
    both_arms(
        right_shoulder_y=10, right_shoulder_x=-75, right_elbow_x=-25, waist_x=10, head_x=-10
    ),  # forward
    both_arms(right_shoulder_y=25, right_shoulder_x=-120, right_elbow_x=-50),  # up
    both_arms(right_shoulder_y=60, right_shoulder_x=-20, right_elbow_x=-40, right_wrist_y=10),  # to the side
    both_arms(
        right_shoulder_y=25, right_shoulder_z=30, right_shoulder_x=-20, right_elbow_x=-110
    ),  # to the chest
    both_arms(
        right_shoulder_y=30, right_shoulder_x=-50, right_elbow_x=-118, head_x=10, right_wrist_x=20
    ),  # mouth
    both_arms(right_shoulder_y=12, right_shoulder_x=-25, right_elbow_x=-80, right_forearm_z=-70),  # palms up
    both_arms(right_shoulder_y=10, right_shoulder_x=-20, head_z=40, waist_y=10, waist_z=15),  # looking aside
    RELAXED_JOINT_ANGLES_RAD,
)


def test_smooth_movements_are_followed_without_a_jump() -> None:
    """From pose to pose in 1 s each at 100 Hz: no joint turns by 0.1 rad in a frame, hands stay within 1 cm and 5°."""
    skeleton, solver = Skeleton(WOMAN), BodySolver(WOMAN)
    angles = RELAXED_JOINT_ANGLES_RAD
    for start, end in itertools.pairwise(JOURNEY):
        for share in np.linspace(0.0, 1.0, 100):
            least_jerk = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            wanted = skeleton.pose(start + least_jerk * (end - start))
            before, angles = angles, solver.solve(wanted, angles)
            reached = skeleton.pose(angles)
            assert np.abs(angles - before).max() < 0.1
            assert distance(reached.head_pose, wanted.head_pose) < 0.001
            for hand, target in ((reached.left, wanted.left), (reached.right, wanted.right)):
                assert distance(hand, target) < 0.01
                assert turn_deg(hand, target) < 5.0


def test_left_and_right_mirror_each_other(rng: np.random.Generator) -> None:
    person = Person("woman", 0.54)
    skeleton, solver = Skeleton(person), BodySolver(person)
    for wanted_rad in working_poses(rng, 5):
        wanted = skeleton.pose(wanted_rad)
        assert wanted.left is not None
        assert wanted.right is not None
        reflected = BodyPose(mirrored(wanted.head_pose), mirrored(wanted.right), mirrored(wanted.left))
        angles, other = solver.solve(wanted, SEATED_POSE_RAD), solver.solve(reflected, SEATED_POSE_RAD)
        np.testing.assert_allclose(other, (angles * MIRROR)[LEFT_RIGHT], atol=1e-9)


def test_a_hand_that_is_not_tracked_stays() -> None:
    person = Person("woman", 0.54)
    wanted = Skeleton(person).pose(human.make_seated_joint_angles(right_elbow_x=-60.0, left_elbow_x=-60.0))
    angles = BodySolver(person).solve(BodyPose(wanted.head_pose, None, wanted.right), SEATED_POSE_RAD)
    left = [i for i, name in enumerate(JOINTS) if name.startswith("left_")]
    np.testing.assert_array_equal(angles[left], SEATED_POSE_RAD[left])
    assert not np.array_equal(angles, SEATED_POSE_RAD)


def test_angles_stay_within_their_ranges_whatever_is_asked(rng: np.random.Generator) -> None:
    solver, angles = BodySolver(Person()), SEATED_POSE_RAD
    for _ in range(30):
        poses = [Pose(rng.uniform(-2, 2, 3), transforms.normalize(rng.normal(size=4))) for _ in range(3)]
        angles = solver.solve(BodyPose(*poses), angles)
        assert np.isfinite(angles).all()
        assert (angles >= LOWER_LIMITS_RAD).all()
        assert (angles <= UPPER_LIMITS_RAD).all()
