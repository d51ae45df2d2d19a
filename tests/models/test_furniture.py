import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import transforms
from avrgym.models import collision_bits, human
from avrgym.models.furniture import (
    BOWL_BODY,
    BOWL_INITIAL_POS_M,
    FURNITURE_BUILDERS,
    NIGHTSTAND_BODY,
    NIGHTSTAND_TOP_POS_M,
    add_wheelchair,
)
from avrgym.models.human import RECLINED_POSTURE, SEATED_POSTURE, Person, Posture, make_seated_joint_angles
from avrgym.robots.jaco.robot import JACO

BED = ("bed_mattress", "bed_backrest", "bed_deck", "bed_footboard", "bed_headboard")
MATTRESS_TOP_M = 0.55
SHORT_AND_TALL = [
    ("man", 0.50),
    ("man", 0.60),
    ("man", 0.70),
    ("woman", 0.44),
    ("woman", 0.54),
    ("woman", 0.64),
]
LEG_PARTS = [f"{side}_{part}" for side in ("right", "left") for part in ("thigh", "shin", "foot")]
BACK_PARTS = ("waist", "chest", "right_shoulder", "left_shoulder")
SCRATCHED_RAD = make_seated_joint_angles(right_shoulder_y=30.0)
ARM_SPREAD_DEG = 10.0
FOOTPRINT_RADIUS_M = 0.05
"""The Jaco's foot is 8.5 cm across."""


def add_wheelchair_with_bracket(spec: mujoco.MjSpec, appearance: bool) -> None:
    bracket = JACO.mounts["wheelchair"].carrier_builder
    assert bracket is not None
    add_wheelchair(spec, appearance)
    bracket(spec, appearance)


TO_BUILD = {**FURNITURE_BUILDERS, "wheelchair and bracket": add_wheelchair_with_bracket}


def compiled(*names: str, appearance: bool = False) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    for name in names:
        TO_BUILD[name](spec, appearance)
    return spec.compile()


def placed(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return data


def with_person(furniture: str, person: Person, posture: Posture) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    human.add_person(spec, person, posture, moving=False)
    FURNITURE_BUILDERS[furniture](spec, False)
    return spec.compile()


def capsule(model: mujoco.MjModel, data: mujoco.MjData, part: str) -> tuple[np.ndarray, float]:
    """The ends (2, 3) of a body part's axis and its radius."""
    name = human.PERSON_NAME_PREFIX + part
    radius, half, _ = model.geom(name).size
    along = half * data.geom(name).xmat.reshape(3, 3)[:, 2]
    centre = data.geom(name).xpos
    return np.stack([centre - along, centre + along]), float(radius)


def from_top_of(model: mujoco.MjModel, data: mujoco.MjData, box: str, points_w: np.ndarray) -> np.ndarray:
    """Points (..., 3) in a box's axes, from the middle of its top."""
    local = (points_w - data.geom(box).xpos) @ data.geom(box).xmat.reshape(3, 3)
    return local - [0.0, 0.0, model.geom(box).size[2]]


def distance(model: mujoco.MjModel, data: mujoco.MjData, one: str, other: str) -> float:
    far = 1.0
    return mujoco.mj_geomDistance(model, data, model.geom(one).id, model.geom(other).id, far, None)


# All furniture


@pytest.mark.parametrize("name", TO_BUILD)
def test_visual_geoms_do_not_change_furniture_collision(name):
    plain, seen = (compiled(name, appearance=shown) for shown in (False, True))
    touching = [seen.geom(i).name for i in np.nonzero(seen.geom_group == collision_bits.COLLISION_GROUP)[0]]
    assert touching == [plain.geom(i).name for i in range(plain.ngeom)]
    for geom in touching:
        for field in ("type", "size", "pos", "quat", "contype", "conaffinity"):
            assert_allclose(getattr(seen.geom(geom), field), getattr(plain.geom(geom), field))
    visible = seen.geom_group != collision_bits.COLLISION_GROUP
    assert not (seen.geom_contype | seen.geom_conaffinity)[visible].any()
    assert seen.ngeom > plain.ngeom


@pytest.mark.parametrize("name", TO_BUILD)
def test_furniture_is_static_with_furniture_bits(name):
    model = compiled(name)
    assert model.nv == 0
    assert (model.body_weldid == 0).all()
    solid = model.geom_contype != collision_bits.NO_COLLISION.contype
    assert (model.geom_contype[solid] == collision_bits.FURNITURE.contype).all()
    assert (model.geom_conaffinity[solid] == collision_bits.FURNITURE.conaffinity).all()
    assert not model.geom_conaffinity[~solid].any()


@pytest.mark.parametrize("name", TO_BUILD)
def test_furniture_stands_on_the_floor(name):
    """What is drawn reaches the floor, give or take 1.5 cm, and nothing is below it."""
    model = compiled(name, appearance=True)
    data = placed(model)
    turned = np.abs(data.geom_xmat.reshape(-1, 3, 3)[:, 2])
    middle = data.geom_xpos[:, 2] + np.einsum(
        "gi,gi->g", data.geom_xmat.reshape(-1, 3, 3)[:, 2], model.geom_aabb[:, :3]
    )
    lowest = (middle - np.einsum("gi,gi->g", turned, model.geom_aabb[:, 3:])).min()
    assert -0.001 < lowest < 0.015


def test_the_bowl_stands_where_a_task_puts_it():
    assert_allclose(compiled("table").body(BOWL_BODY).pos, BOWL_INITIAL_POS_M)


# Bed


def test_the_bed_has_the_size_of_a_hospital_bed():
    model = compiled("hospital_bed")
    data = placed(model)
    legs, back = model.geom("bed_mattress").size, model.geom("bed_backrest").size
    for half in (legs, back):
        assert_allclose(2.0 * half[[0, 2]], [0.88, 0.15])
    assert 2.0 * (legs[1] + back[1]) == pytest.approx(2.00)
    assert data.geom("bed_mattress").xpos[2] + legs[2] == pytest.approx(MATTRESS_TOP_M)


def test_the_backrest_is_raised_by_60_degrees_from_where_the_seat_ends():
    model = compiled("hospital_bed")
    data = placed(model)
    turn = transforms.from_matrix(data.geom("bed_backrest").xmat.reshape(3, 3))
    assert_allclose(transforms.to_rotation_vector(turn), [np.radians(60.0), 0.0, 0.0], atol=1e-9)
    half = model.geom("bed_mattress").size
    end_of_seat = data.geom("bed_mattress").xpos + half * [0.0, 1.0, 1.0]
    corner = from_top_of(model, data, "bed_backrest", end_of_seat)
    assert_allclose(corner, [0.0, -model.geom("bed_backrest").size[1], 0.0], atol=1e-9)


@pytest.mark.parametrize(("sex", "torso_height"), SHORT_AND_TALL)
def test_legs_lie_on_the_mattress(sex, torso_height):
    """Thighs sink in by at most 1.5 cm, nothing floats more than 6 cm above, and feet do not stick out."""
    model = with_person("hospital_bed", Person(sex, torso_height), RECLINED_POSTURE)
    data = placed(model)
    half_width, half_length, _ = model.geom("bed_mattress").size
    for part in LEG_PARTS:
        ends, radius = capsule(model, data, part)
        lowest = from_top_of(model, data, "bed_mattress", ends).min(axis=0) - radius
        assert -half_width < lowest[0] < half_width - 2.0 * radius
        assert -half_length < lowest[1] < half_length
        assert -0.015 < lowest[2] < 0.06


@pytest.mark.parametrize(("sex", "torso_height"), SHORT_AND_TALL)
def test_the_back_rests_on_the_backrest(sex, torso_height):
    """The trunk sinks in by at most 1 cm; no part of it is more than 3 cm away, and the head is before it."""
    model = with_person("hospital_bed", Person(sex, torso_height), RECLINED_POSTURE)
    data = placed(model)
    for part in BACK_PARTS:
        ends, radius = capsule(model, data, part)
        gap = from_top_of(model, data, "bed_backrest", ends)[:, 2] - radius
        assert gap.min() > -0.01
        assert gap.max() < 0.03
    head = from_top_of(model, data, "bed_backrest", data.site(human.PERSON_NAME_PREFIX + "head_centre").xpos)
    assert (np.abs(head[:2]) < model.geom("bed_backrest").size[:2]).all()


@pytest.mark.parametrize(("sex", "torso_height"), SHORT_AND_TALL)
def test_nothing_of_the_bed_but_its_mattress_is_near_the_person(sex, torso_height):
    model = with_person("hospital_bed", Person(sex, torso_height), RECLINED_POSTURE)
    data = placed(model)
    for part in human.GEOMS:
        for board in ("bed_footboard", "bed_headboard", "bed_deck"):
            assert distance(model, data, human.PERSON_NAME_PREFIX + part, board) > 0.01


# Nightstand


def test_a_robot_has_room_on_the_nightstand():
    model = compiled("nightstand")
    half, centre = model.geom(NIGHTSTAND_BODY).size, model.geom(NIGHTSTAND_BODY).pos
    assert_allclose(model.body(NIGHTSTAND_BODY).pos, NIGHTSTAND_TOP_POS_M)
    assert centre[2] + half[2] == pytest.approx(0.0)
    assert (half[:2] - np.abs(centre[:2]) > FOOTPRINT_RADIUS_M).all()


@pytest.mark.parametrize("dx", [-0.1, 0.1])
@pytest.mark.parametrize("dy", [-0.1, 0.1])
def test_the_nightstand_clears_the_bed_wherever_the_robot_is_put(dx, dy):
    """Also what is only drawn of either."""
    model = compiled("hospital_bed", "nightstand", appearance=True)
    model.body_pos[model.body(NIGHTSTAND_BODY).id] += [dx, dy, 0.0]
    data = placed(model)
    stand = [i for i in range(model.ngeom) if model.geom_bodyid[i] == model.body(NIGHTSTAND_BODY).id]
    bed = [i for i in range(model.ngeom) if model.geom_bodyid[i] == model.body("hospital_bed").id]
    gaps = [mujoco.mj_geomDistance(model, data, one, other, 1.0, None) for one in stand for other in bed]
    assert min(gaps) > 0.01


# Wheelchair


def extent(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """The least and the greatest coordinates (3,) of all that is seen."""
    data = placed(model)
    points = []
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        if mesh >= 0:
            first = model.mesh_vertadr[mesh]
            local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        else:
            middle, half = np.split(model.geom_aabb[geom], 2)
            local = middle + half * np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T
        points.append(data.geom_xpos[geom] + local @ data.geom_xmat[geom].reshape(3, 3).T)
    everything = np.concatenate(points)
    return everything.min(axis=0), everything.max(axis=0)


def test_the_wheelchair_has_its_documented_size():
    """Near the tables' 660 mm, 1065 mm, 485 mm and 760 mm; the grips of the push handles are 32 mm thick."""
    model = compiled("wheelchair", appearance=True)
    data = placed(model)
    low, high = extent(model)
    assert_allclose(high - low, [0.658, 1.020, 0.932], atol=0.002)
    tops = {name: data.geom(f"wheelchair_{name}").xpos[2] + model.geom(f"wheelchair_{name}").size[2]
            for name in ("seat", "left_armrest", "right_armrest")}  # fmt: skip
    assert tops == pytest.approx({"seat": 0.485, "left_armrest": 0.760, "right_armrest": 0.760})
    assert high[2] - 0.016 == pytest.approx(0.915, abs=0.002)
    assert_allclose(2.0 * model.geom("wheelchair_seat").size[:2], [0.460, 0.410])


def test_an_armrest_can_be_taken_off():
    whole, open_right = compiled("wheelchair"), compiled("wheelchair_without_right_armrest")
    names = [{model.geom(i).name for i in range(model.ngeom)} for model in (whole, open_right)]
    assert names[0] - names[1] == {"wheelchair_right_armrest"}


@pytest.mark.parametrize(("sex", "torso_height"), SHORT_AND_TALL)
def test_an_arm_to_be_scratched_is_clear_of_the_wheelchair_without_its_armrest(sex, torso_height, rng):
    spread = np.array([np.radians(ARM_SPREAD_DEG) * name.startswith("right_") for name in human.JOINTS])
    for share in rng.uniform(-1.0, 1.0, (10, len(spread))):
        person = Person(sex, torso_height, SCRATCHED_RAD + share * spread)
        model = with_person("wheelchair_without_right_armrest", person, SEATED_POSTURE)
        data = placed(model)
        for part in ("right_forearm", "right_hand"):
            for piece in ("seat", "right_wheel"):
                assert distance(model, data, human.PERSON_NAME_PREFIX + part, f"wheelchair_{piece}") > 0.01
