import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.furniture import (
    add_hospital_bed,
    add_nightstand,
    add_wheelchair,
    add_wheelchair_without_right_armrest,
)
from avrgym.models.human import (
    GEOMS,
    JOINT_INDEX,
    JOINTS,
    LOWER_LIMITS_RAD,
    PERSON_NAME_PREFIX,
    RECLINED_POSTURE,
    RIGHT_ARM_BODIES,
    SEATED_POSTURE,
    UPPER_LIMITS_RAD,
    People,
    Person,
    make_seated_joint_angles,
)
from avrgym.people.arm_clearance import (
    CHECKED_CAPSULE_PAIRS,
    Boxes,
    compute_arm_clearance_m,
    compute_person_capsules,
    make_furniture_boxes,
)

NAMES = list(GEOMS)
POSTURES = {"seated": SEATED_POSTURE, "reclined": RECLINED_POSTURE}
SCRATCHING = make_seated_joint_angles(right_shoulder_y=30.0)
BATHING = make_seated_joint_angles(
    right_shoulder_y=20.0, right_shoulder_x=-20.0, right_elbow_x=-45.0,
    left_shoulder_y=-20.0, left_shoulder_x=-20.0, left_elbow_x=-45.0,
)  # fmt: skip


def random_people(rng: np.random.Generator, count: int) -> People:
    angles = rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, (count, len(JOINTS)))
    return People.make_unimpaired(rng.random(count) < 0.5, rng.uniform(0.44, 0.70, count), angles)


def people_about(rng: np.random.Generator, pose: np.ndarray, count: int) -> People:
    """People of any size in a pose, ± 10° in every joint of the waist and the right arm."""
    moved = [i for name, i in JOINT_INDEX.items() if name.startswith(("waist", "right"))]
    angles = np.tile(pose, (count, 1))
    angles[:, moved] += np.radians(rng.uniform(-10.0, 10.0, (count, len(moved))))
    is_woman = rng.random(count) < 0.5
    height = np.where(is_woman, rng.uniform(0.44, 0.64, count), rng.uniform(0.50, 0.70, count))
    return People.make_unimpaired(is_woman, height, angles)


# Capsules


@pytest.mark.parametrize("posture", POSTURES.values(), ids=POSTURES)
def test_the_capsules_are_those_of_mujoco(rng, posture):
    people = random_people(rng, 15)
    segments, radii = compute_person_capsules(people, posture)
    assert segments.shape == (15, len(GEOMS), 2, 3)
    for i in range(15):
        model, data = compiled(people.get_person(i), posture)
        for j, name in enumerate(GEOMS):
            geom = data.geom(PERSON_NAME_PREFIX + name)
            reach = geom.xmat.reshape(3, 3)[:, 2] * model.geom(PERSON_NAME_PREFIX + name).size[1]
            assert_allclose(segments[i, j], [geom.xpos - reach, geom.xpos + reach], atol=1e-9)
            assert radii[i, j] == pytest.approx(model.geom(PERSON_NAME_PREFIX + name).size[0], abs=1e-12)


def compiled(person: Person, posture: human.Posture) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = human.compile_person_model(person, posture, moving=False)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


# Clearance


@pytest.mark.parametrize("posture", POSTURES.values(), ids=POSTURES)
def test_the_clearance_is_the_smallest_distance_that_mujoco_finds(rng, posture):
    people = random_people(rng, 15)
    expected = [nearest_pair(people.get_person(i), posture) for i in range(15)]
    assert_allclose(compute_arm_clearance_m(*compute_person_capsules(people, posture)), expected, atol=1e-6)


def nearest_pair(person: Person, posture: human.Posture) -> float:
    model, data = compiled(person, posture)
    ids = {name: model.geom(PERSON_NAME_PREFIX + name).id for name in GEOMS}
    return min(
        mujoco.mj_geomDistance(model, data, ids[a], ids[b], 10.0, None) for a, b in CHECKED_CAPSULE_PAIRS
    )


def test_every_part_of_the_arm_keeps_away_from_head_hips_legs_and_the_other_arm():
    for part in RIGHT_ARM_BODIES:
        others = {other for arm, other in CHECKED_CAPSULE_PAIRS if arm == part}
        assert not others & set(RIGHT_ARM_BODIES)
        assert others >= {"hips", "waist", "neck", "cranium", "jaw", "right_thigh", "left_thigh", "left_hand"}
    assert ("right_forearm", "chest") in CHECKED_CAPSULE_PAIRS


def test_a_hand_in_the_face_overlaps_and_a_raised_arm_is_free():
    face = make_seated_joint_angles(right_shoulder_x=-80.0, right_shoulder_z=40.0, right_elbow_x=-128.0)
    raised = make_seated_joint_angles(right_shoulder_y=90.0, right_elbow_x=0.0)
    gap = compute_arm_clearance_m(
        *compute_person_capsules(People.from_persons([Person("man", 0.6, face), Person("man", 0.6, raised)]))
    )
    assert gap[0] < 0.0
    assert gap[1] > 0.05


def test_furniture_counts_where_it_is_closer_than_the_body():
    people = People.from_persons(
        [Person("man", 0.6, make_seated_joint_angles(right_shoulder_y=90.0, right_elbow_x=0.0))]
    )
    segments, radii = compute_person_capsules(people)
    forearm = NAMES.index("right_forearm")
    above = segments[0, forearm].mean(axis=0)
    above[2] += 0.10 + radii[0, forearm]
    far = np.array([5.0, 5.0, 5.0])
    turn = transforms.from_axis_angle(human.Z_AXIS, np.asarray(0.7))
    boxes = Boxes(np.stack([above, far]), np.stack([turn, turn]), np.array([[0.01, 0.01, 0.05], [0.1] * 3]))
    assert compute_arm_clearance_m(segments, radii)[0] > 0.06
    assert compute_arm_clearance_m(segments, radii, boxes)[0] == pytest.approx(0.05, abs=1e-9)
    only_far = Boxes(boxes.pos_w[1:], boxes.quat_w[1:], boxes.half_size_m[1:])
    assert_array_equal(
        compute_arm_clearance_m(segments, radii, only_far), compute_arm_clearance_m(segments, radii)
    )


def test_a_person_does_not_depend_on_others(rng):
    people = random_people(rng, 9)
    segments, radii = compute_person_capsules(people)
    alone = People.from_persons([people.get_person(4)])
    alone_segments, alone_radii = compute_person_capsules(alone)
    assert_array_equal(alone_segments[0], segments[4])
    boxes = Boxes(*(rng.uniform(0.1, 1.0, (2, 3)), transforms.normalize(rng.normal(size=(2, 4)))),
                  rng.uniform(0.1, 0.2, (2, 3)))  # fmt: skip
    among = compute_arm_clearance_m(segments, radii, boxes)
    assert_array_equal(compute_arm_clearance_m(alone_segments, alone_radii, boxes)[0], among[4])


# Furniture and the poses of the tasks


def test_furniture_is_found_where_it_stands():
    boxes = make_furniture_boxes([add_wheelchair])
    tops = boxes.pos_w[:, 2] + boxes.half_size_m[:, 2]
    armrests = np.abs(tops - 0.76) < 1e-9
    assert_allclose(np.sort(boxes.pos_w[armrests, 0]), [-0.265, 0.265])
    assert_allclose(boxes.quat_w, np.tile(transforms.IDENTITY_QUATERNION, (len(tops), 1)))


def test_tilted_furniture_boxes_are_tilted():
    up_the_backrest = transforms.rotate(make_furniture_boxes([add_hospital_bed]).quat_w, human.Y_AXIS)
    slope = np.degrees(np.arctan2(up_the_backrest[:, 2], up_the_backrest[:, 1]))
    assert np.isclose(slope, 60.0).sum() == 1


@pytest.mark.parametrize(
    ("pose", "posture", "furniture"),
    [
        (SCRATCHING, SEATED_POSTURE, [add_wheelchair_without_right_armrest]),
        (BATHING, RECLINED_POSTURE, [add_hospital_bed, add_nightstand]),
    ],
)
def test_most_poses_of_the_tasks_are_free(rng, pose, posture, furniture):
    capsules = compute_person_capsules(people_about(rng, pose, 500), posture)
    assert (compute_arm_clearance_m(*capsules, make_furniture_boxes(furniture)) > 0.01).mean() > 0.95


def test_an_armrest_is_in_the_way_of_the_arm_to_be_scratched(rng):
    capsules = compute_person_capsules(people_about(rng, SCRATCHING, 500))
    assert (compute_arm_clearance_m(*capsules) > 0.01).mean() > 0.95
    assert (compute_arm_clearance_m(*capsules, make_furniture_boxes([add_wheelchair])) < 0.0).mean() > 0.5
