import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import (
    BODY_DIMENSIONS,
    JOINTS,
    LOWER_LIMITS_RAD,
    PERSON_NAME_PREFIX,
    SEATED_POSE_RAD,
    UPPER_LIMITS_RAD,
    People,
    Person,
)

MASSES_KG = {"man": 78.4, "woman": 62.5}
HIPS_ORIGIN = {"man": (0.0, 0.03, 0.65275), "woman": (0.0, 0.03, 0.635)}
TORSO_HEIGHTS = np.linspace(0.40, 0.75, 15)
OTHER_SIDE = {"right": "left", "left": "right"}


def mirrored(name: str) -> str:
    """The body or joint of the same name on the other side."""
    side, _, part = name.partition("_")
    return f"{OTHER_SIDE[side]}_{part}" if side in OTHER_SIDE else name


def random_angles(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(LOWER_LIMITS_RAD, UPPER_LIMITS_RAD, (count, len(JOINTS)))


def random_people(rng: np.random.Generator, count: int) -> People:
    return People.make_unimpaired(
        rng.random(count) < 0.5, rng.uniform(0.44, 0.70, count), random_angles(rng, count)
    )


def single(person: Person) -> People:
    return People.from_persons([person])


# Mass


@pytest.mark.parametrize("sex", human.SEXES)
@pytest.mark.parametrize("torso_height", [0.44, 0.60])
def test_a_person_weighs_what_the_table_says(sex, torso_height):
    model = human.compile_person_model(Person(sex, torso_height), moving=True)
    assert model.body_mass.sum() == pytest.approx(MASSES_KG[sex], rel=1e-9)


def test_each_part_has_its_share_of_the_mass():
    model = human.compile_person_model(Person("man", 0.6), moving=True)
    share = {name: model.body(PERSON_NAME_PREFIX + name).mass[0] / 78.4 for name in human.BODIES}
    expected = {"hips": 0.14, "torso": 0.13 + 0.10 + 2 * 0.05 + 0.01, "head": 0.07}
    parts = {
        "upper_arm": 0.033,
        "forearm": 0.019,
        "hand": 0.0065,
        "thigh": 0.105,
        "shin": 0.0475,
        "foot": 0.014,
    }
    expected |= {f"{side}_{part}": value for side in ("right", "left") for part, value in parts.items()}
    assert share == pytest.approx(expected)


# Size


@pytest.mark.parametrize("sex", human.SEXES)
def test_the_torso_height_is_from_hips_to_head_centre(sex):
    for torso_height in TORSO_HEIGHTS:
        person = Person(sex, float(torso_height), np.zeros(len(JOINTS)))
        frames = human.compute_body_layout(np.array([sex == "woman"]), np.array([torso_height]))
        pos, _ = human.compute_body_frames(single(person))
        centre = pos["head"] + frames.site_pos["head_centre"]
        assert_allclose(centre - pos["hips"], [[0.0, 0.0, torso_height]], atol=1e-12)
        assert_allclose(pos["hips"][0], HIPS_ORIGIN[sex])


@pytest.mark.parametrize("sex", human.SEXES)
def test_lengths_grow_with_the_torso_and_radii_do_not(sex):
    heights = BODY_DIMENSIONS[sex].torso_height_m * np.array([1.0, 1.2])
    frames = human.compute_body_layout(np.array([sex == "woman"] * 2), heights)
    for name in ("right_upper_arm", "left_forearm", "left_thigh", "right_shin", "neck"):
        (radius, half, _), (taller_radius, taller_half, _) = frames.geom_size[name]
        assert taller_radius == radius
        assert taller_half == pytest.approx(1.2 * half)
    assert_allclose(frames.body_pos["left_shin"][1], 1.2 * frames.body_pos["left_shin"][0])


@pytest.mark.parametrize("sex", human.SEXES)
def test_the_mouth_is_on_the_face(sex):
    frames = human.compute_body_layout(
        np.array([sex == "woman"]), np.array([BODY_DIMENSIONS[sex].torso_height_m])
    )
    forward = {"man": 0.11, "woman": 0.10}[sex]
    assert_allclose(frames.site_pos["mouth"], [[0.0, -forward, 0.03]])


# One layout for all


@pytest.mark.parametrize("moving", [False, True])
def test_the_layout_is_that_of_the_compiled_model(rng, moving):
    people = random_people(rng, 4)
    frames = human.compute_body_layout(people.is_woman, people.torso_height_m)
    for i in range(4):
        model = human.compile_person_model(people.get_person(i), moving=moving)
        for name in human.BODIES:
            assert_allclose(model.body(PERSON_NAME_PREFIX + name).pos, frames.body_pos[name][i], atol=1e-12)
        for name in human.GEOMS:
            assert_allclose(model.geom(PERSON_NAME_PREFIX + name).pos, frames.geom_pos[name][i], atol=1e-12)
            assert_allclose(model.geom(PERSON_NAME_PREFIX + name).size, frames.geom_size[name][i], atol=1e-12)
        for name in human.SITE_BODIES:
            assert_allclose(model.site(PERSON_NAME_PREFIX + name).pos, frames.site_pos[name][i], atol=1e-12)


@pytest.mark.parametrize("moving", [False, True])
def test_the_frames_are_those_of_mujoco(rng, moving):
    people = random_people(rng, 20)
    pos, q = human.compute_body_frames(people)
    for i in range(20):
        model = human.compile_person_model(people.get_person(i), moving=moving)
        data = mujoco.MjData(model)
        if moving:
            for name, angle in zip(JOINTS, people.joint_angles_rad[i], strict=True):
                data.joint(PERSON_NAME_PREFIX + name).qpos[0] = angle
        mujoco.mj_kinematics(model, data)
        for name in human.BODIES:
            assert_allclose(pos[name][i], data.body(PERSON_NAME_PREFIX + name).xpos, atol=1e-6)
            assert_allclose(
                transforms.to_matrix(q[name][i]),
                data.body(PERSON_NAME_PREFIX + name).xmat.reshape(3, 3),
                atol=1e-6,
            )


def test_left_and_right_mirror_each_other(rng):
    """A pose's mirror image is the pose of the mirrored joints: turns about x stay, others change sign."""
    angles = random_angles(rng, 50)
    reflected = np.empty_like(angles)
    for column, name in enumerate(JOINTS):
        sign = 1.0 if name.endswith("x") else -1.0
        reflected[:, human.JOINT_INDEX[mirrored(name)]] = sign * angles[:, column]
    assert (reflected >= LOWER_LIMITS_RAD - 1e-12).all()
    assert (reflected <= UPPER_LIMITS_RAD + 1e-12).all()
    is_woman, heights = rng.random(50) < 0.5, rng.uniform(0.5, 0.6, 50)
    pos, _ = human.compute_body_frames(People.make_unimpaired(is_woman, heights, angles))
    reflected_pos, _ = human.compute_body_frames(People.make_unimpaired(is_woman, heights, reflected))
    for name in human.BODIES:
        assert_allclose(reflected_pos[mirrored(name)], pos[name] * [-1.0, 1.0, 1.0], atol=1e-12)


# Joints


RANGES_DEG = {
    "waist_x": (-30, 75), "waist_y": (-30, 30), "waist_z": (-30, 30),
    "head_x": (-50, 50), "head_y": (-34, 34), "head_z": (-70, 70),
    "right_shoulder_y": (-180, 198), "right_shoulder_x": (-188, 61), "right_shoulder_z": (-90, 90),
    "right_elbow_x": (-128, 0), "right_forearm_z": (-90, 90),
    "right_wrist_x": (-81, 90), "right_wrist_y": (-27, 47),
    "left_shoulder_y": (-198, 180), "left_shoulder_x": (-188, 61), "left_shoulder_z": (-90, 90),
    "left_elbow_x": (-128, 0), "left_forearm_z": (-90, 90),
    "left_wrist_x": (-81, 90), "left_wrist_y": (-47, 27),
}  # fmt: skip


def test_twenty_joints_have_the_ranges_of_the_table():
    assert {
        name: (joint.lower_limit_deg, joint.upper_limit_deg) for name, joint in JOINTS.items()
    } == RANGES_DEG
    assert len(JOINTS) == 20


def test_the_moving_person_has_these_joints_ranges_and_torques():
    model = human.compile_person_model(Person(), moving=True)
    assert model.nq == model.nu == 20
    for name, joint in JOINTS.items():
        limits = np.radians([joint.lower_limit_deg, joint.upper_limit_deg])
        assert_allclose(model.joint(PERSON_NAME_PREFIX + name).range, limits)
        assert_allclose(model.actuator(PERSON_NAME_PREFIX + name).ctrlrange, limits)
        assert_allclose(
            model.actuator(PERSON_NAME_PREFIX + name).forcerange,
            [-joint.torque_limit_n_m, joint.torque_limit_n_m],
        )


def test_the_static_person_has_none():
    model = human.compile_person_model(Person(), moving=False)
    assert model.nq == model.nu == 0


def test_the_seated_pose_bends_hips_knees_and_elbows():
    pos, _ = human.compute_body_frames(single(Person("man", 0.6)))
    thigh = pos["right_shin"] - pos["right_thigh"]
    assert_allclose(thigh, [[0.0, -0.424, 0.0]], atol=1e-12)
    forearm = pos["left_hand"] - pos["left_forearm"]
    assert_allclose(forearm / np.linalg.norm(forearm), [[0.0, -1.0, 0.0]], atol=1e-12)
    assert ((SEATED_POSE_RAD >= LOWER_LIMITS_RAD) & (SEATED_POSE_RAD <= UPPER_LIMITS_RAD)).all()


# What is refused


def test_an_unknown_sex_names_the_models():
    with pytest.raises(ValueError, match="unknown sex 'robot'; allowed: man, woman"):
        Person("robot")  # pyright: ignore[reportArgumentType]


def test_an_unknown_joint_names_the_joints():
    with pytest.raises(
        ValueError, match=r"unknown joint 'tail_x'; allowed: waist_x, waist_y, .*left_wrist_y"
    ):
        human.make_seated_joint_angles(tail_x=10.0)


@pytest.mark.parametrize("torso_height", [3.0, 0.1, float("nan")])
def test_an_impossible_torso_height_names_the_range(torso_height):
    with pytest.raises(ValueError, match=r"allowed: 0\.40 to 0\.75 m"):
        Person("man", torso_height)


def test_joint_angles_of_a_wrong_shape_name_the_right_one():
    with pytest.raises(ValueError, match=r"shape \(6,\); allowed: \(20,\)"):
        Person("man", 0.6, np.zeros(6))
