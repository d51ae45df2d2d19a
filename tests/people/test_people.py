import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models.human import (
    JOINT_INDEX,
    LOWER_LIMITS_RAD,
    SEATED_POSE_RAD,
    SEATED_POSTURE,
    UPPER_LIMITS_RAD,
    People,
    Person,
    make_seated_joint_angles,
)
from avrgym.people import distributions, shoulder_limits
from avrgym.people.arm_clearance import compute_arm_clearance_m, compute_person_capsules, make_furniture_boxes
from avrgym.robots.jaco.robot import JACO
from avrgym.tasks.person import TURNED_HEAD_POSE
from avrgym.tasks.registry import TASKS

COUNT = 4000
WAIST = [JOINT_INDEX[f"waist_{axis}"] for axis in "xyz"]
HEAD = [JOINT_INDEX[f"head_{axis}"] for axis in "xyz"]
REST = [index for index in range(20) if index not in WAIST + HEAD]
TORSO_HEIGHTS_M = {"original": ((0.60, 0.60), (0.54, 0.54)), "revised": ((0.50, 0.70), (0.44, 0.64))}
WAIST_DEG = {"original": 0.0, "revised": 10.0}
HEAD_DEG = {"original": 30.0, "revised": 30.0}


@pytest.fixture(params=["original", "revised"])
def name(request) -> str:
    return request.param


def sampled(name: str, rng: np.random.Generator, count: int = COUNT) -> People:
    return distributions.sample_people(
        distributions.find_distribution(name, TASKS),
        TURNED_HEAD_POSE,
        SEATED_POSTURE,
        None,
        rng.random((count, distributions.NUM_RANDOM_NUMBERS)),
    )


def assert_fills(values: np.ndarray, low: float, high: float) -> None:
    """Within the range, and to within 1 % of both ends."""
    slack = 0.01 * (high - low)
    assert values.min() >= low - 1e-12
    assert values.max() <= high + 1e-12
    assert values.min() <= low + slack
    assert values.max() >= high - slack


def test_men_and_women_are_equally_likely(rng, name):
    assert sampled(name, rng).is_woman.mean() == pytest.approx(0.5, abs=0.03)


def test_torso_heights_fill_the_range_of_the_paper(rng, name):
    group = sampled(name, rng)
    for chosen, (low, high) in zip((~group.is_woman, group.is_woman), TORSO_HEIGHTS_M[name], strict=True):
        assert_fills(group.torso_height_m[chosen], low, high)


def test_waist_and_head_fill_the_range_of_the_paper(rng, name):
    offset = np.degrees(sampled(name, rng).joint_angles_rad - SEATED_POSE_RAD)
    for joint in WAIST:
        assert_fills(offset[:, joint], -WAIST_DEG[name], WAIST_DEG[name])
    for joint in HEAD:
        assert_fills(offset[:, joint], -HEAD_DEG[name], HEAD_DEG[name])
    assert_array_equal(offset[:, REST], 0.0)


def test_sampled_poses_are_within_joint_ranges(rng, name):
    angles = sampled(name, rng).joint_angles_rad
    assert (angles >= LOWER_LIMITS_RAD).all()
    assert (angles <= UPPER_LIMITS_RAD).all()


def test_joints_and_torso_height_are_drawn_independently(rng):
    group = sampled("revised", rng)
    columns = np.column_stack([group.is_woman, group.joint_angles_rad[:, WAIST + HEAD]])
    correlation = np.corrcoef(columns, rowvar=False) - np.eye(7)
    assert np.abs(correlation).max() < 0.06


def test_a_person_does_not_depend_on_other_worlds(rng, name):
    uniforms = rng.random((50, distributions.NUM_RANDOM_NUMBERS))
    distribution = distributions.find_distribution(name, TASKS)
    together = distributions.sample_people(distribution, TURNED_HEAD_POSE, SEATED_POSTURE, None, uniforms)
    for i in (0, 17, 49):
        alone = distributions.sample_people(
            distribution, TURNED_HEAD_POSE, SEATED_POSTURE, None, uniforms[i : i + 1]
        )
        assert_array_equal(alone.is_woman, together.is_woman[[i]])
        assert_array_equal(alone.torso_height_m, together.torso_height_m[[i]])
        assert_array_equal(alone.joint_angles_rad, together.joint_angles_rad[[i]])


@pytest.mark.parametrize(
    "task",
    [task for task in TASKS.values() if task.pose_distribution.has_random_arm_pose],
    ids=lambda t: t.name,
)
def test_random_arms_have_clearance_and_possible_shoulders(rng, name, task):
    scene = task.make_scene(JACO)
    furniture = make_furniture_boxes(scene.furniture)
    uniforms = rng.random((1000, distributions.NUM_RANDOM_NUMBERS))
    group = distributions.sample_people(
        distributions.find_distribution(name, TASKS),
        task.pose_distribution,
        scene.posture,
        furniture,
        uniforms,
    )
    assert shoulder_limits.are_shoulders_within_limits(group.joint_angles_rad).all()
    assert compute_arm_clearance_m(*compute_person_capsules(group, scene.posture), furniture).min() >= 0.01
    spread_rad = task.pose_distribution.max_offset_rad[distributions.RIGHT_ARM_JOINT_MASK]
    offset_rad = np.abs(group.joint_angles_rad - task.pose_distribution.rest_angles_rad)[
        :, distributions.RIGHT_ARM_JOINT_MASK
    ]
    assert (offset_rad <= spread_rad + 1e-9).all()
    assert (offset_rad.max(axis=0) > 0.9 * spread_rad).all()


def test_poses_without_clearance_are_sampled_again(rng):
    """An arm that hangs close to the body, ±10°, often has no room; the few that never find any stay."""
    spread = np.where(distributions.RIGHT_ARM_JOINT_MASK, np.radians(10.0), 0.0)
    close = distributions.PoseDistribution(
        make_seated_joint_angles(right_shoulder_y=10.0, right_elbow_x=-20.0), spread
    )
    distribution = distributions.find_distribution("original", TASKS)
    uniforms = rng.random((400, distributions.NUM_RANDOM_NUMBERS))
    once = uniforms.copy()
    once[:, 2:] = np.tile(once[:, 2:22], distributions.MAX_POSE_ATTEMPTS)
    crowded = [
        (
            compute_arm_clearance_m(
                *compute_person_capsules(
                    distributions.sample_people(distribution, close, SEATED_POSTURE, None, drawn)
                )
            )
            < 0.01
        ).mean()
        for drawn in (once, uniforms)
    ]
    assert crowded[0] > 0.2
    assert crowded[1] < 0.05


def test_one_of_many_is_a_person(rng):
    group = sampled("revised", rng, 20)
    for i in range(20):
        person = group.get_person(i)
        assert person.sex == ("woman" if group.is_woman[i] else "man")
        assert person.torso_height_m == group.torso_height_m[i]
        assert_array_equal(person.joint_angles_rad, group.joint_angles_rad[i])


def test_a_person_repeats():
    group = distributions.repeat_person(Person("woman", 0.5), 3)
    assert group.is_woman.all()
    assert_allclose(group.torso_height_m, [0.5] * 3)
    assert group.joint_angles_rad.shape == (3, 20)


def test_an_unknown_distribution_lists_the_distributions():
    with pytest.raises(ValueError, match="unknown population 'martians'; allowed: original, revised"):
        distributions.find_distribution("martians", TASKS)
