"""The rendered body compared with the body of the physics."""

import mujoco
import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import BODIES, RECLINED_POSTURE, SEATED_POSTURE, SEXES, Person, Sex
from avrgym.models.human_shape import (
    HEAD_SKIN_PARTS,
    SKIN_PARTS,
    SkinMesh,
    add_person_skins,
    make_skin_meshes,
)

HEIGHTS_M = {"man": (0.50, 0.60, 0.70), "woman": (0.44, 0.54, 0.64)}
PEOPLE = [(sex, height) for sex in SEXES for height in HEIGHTS_M[sex]]
NEAR_M = 0.02
everybody = pytest.mark.parametrize(("sex", "torso_height_m"), PEOPLE)


def drawn(sex: Sex, torso_height_m: float, *, open_mouth: bool = False) -> dict[str, SkinMesh]:
    return dict(make_skin_meshes(Person(sex, torso_height_m), open_mouth=open_mouth))


def in_body(shape: SkinMesh, sex: Sex, torso_height_m: float, body: str) -> np.ndarray:
    """The vertices that mostly follow a body, in its frame."""
    pos, q = human.compute_bind_frames(sex, torso_height_m)
    weight = np.where(shape.body_indices == BODIES.index(body), shape.body_weights, 0.0).sum(axis=1)
    return transforms.rotate(transforms.conjugate(q[body]), shape.vertices[weight > 0.8] - pos[body])


def outside_capsule(places: np.ndarray, sex: Sex, torso_height_m: float, geom: str) -> np.ndarray:
    """How far places in a body's frame are outside of one of its collision geoms that runs along z."""
    layout = human.compute_body_layout(np.array([sex == "woman"]), np.array([torso_height_m]))
    (centre,), (size,) = layout.geom_pos[geom], layout.geom_size[geom]
    offset = places - centre
    offset[:, 2] -= np.clip(offset[:, 2], -size[1], size[1])
    return np.linalg.norm(offset, axis=1) - size[0]


@everybody
@pytest.mark.parametrize("limb", ["right_upper_arm", "right_forearm", "left_upper_arm", "left_forearm"])
@pytest.mark.fast_cases(6)
def test_visual_arms_match_their_capsules(sex: Sex, torso_height_m: float, limb: str) -> None:
    bare = in_body(drawn(sex, torso_height_m)["body"], sex, torso_height_m, limb)
    gap = outside_capsule(bare, sex, torso_height_m, limb)
    assert np.abs(gap).max() < NEAR_M
    assert np.abs(np.median(gap)) < 0.5 * NEAR_M


@everybody
def test_lips_are_where_the_mouth_is(sex: Sex, torso_height_m: float) -> None:
    face = in_body(drawn(sex, torso_height_m)["face"], sex, torso_height_m, "head")
    (mouth,) = human.compute_body_layout(np.array([sex == "woman"]), np.array([torso_height_m])).site_pos[
        "mouth"
    ]
    before = face[(np.abs(face[:, 0]) < 0.01) & (np.abs(face[:, 2] - mouth[2]) < 0.008)]
    assert abs(before[:, 1].min() - mouth[1]) < 0.01


@everybody
def test_the_visual_head_matches_its_spheres(sex: Sex, torso_height_m: float) -> None:
    """Above the mouth; the nose stands before the spheres."""
    face = in_body(drawn(sex, torso_height_m)["face"], sex, torso_height_m, "head")
    above = face[(face[:, 2] > 0.09) & (face[:, 1] > -0.09)]
    gap = outside_capsule(above, sex, torso_height_m, "cranium")
    assert gap.max() < NEAR_M
    assert gap[above[:, 2] > above[:, 2].max() - 0.01].min() > -NEAR_M


def test_only_the_lower_face_moves_when_the_mouth_opens() -> None:
    mouth = ("face", "teeth", "tongue", "body")
    for sex in SEXES:
        closed, opened = (drawn(sex, 0.6, open_mouth=wide) for wide in (False, True))
        moved = {name: np.abs(opened[name].vertices - closed[name].vertices).max() for name in SKIN_PARTS}
        assert moved["face"] > 0.01
        assert moved["teeth"] > 0.01
        assert max(moved[name] for name in SKIN_PARTS if name not in mouth) < 3e-3
        assert moved["body"] < 0.01


def test_weights_of_every_vertex_sum_to_one() -> None:
    for sex in SEXES:
        for name, shape in drawn(sex, 0.6).items():
            np.testing.assert_allclose(shape.body_weights.sum(axis=1), 1.0, atol=1e-9, err_msg=name)
            assert shape.faces.max() < len(shape.vertices), name


def test_the_heads_parts_move_with_the_head() -> None:
    for sex in SEXES:
        for name, shape in drawn(sex, 0.6).items():
            follows = np.where(shape.body_indices == BODIES.index("head"), shape.body_weights, 0.0).sum(
                axis=1
            )
            assert (follows.mean() > 0.6) == (name in HEAD_SKIN_PARTS), name


def test_sitting_people_wear_shoes_and_lying_people_none() -> None:
    for posture, worn, bare in ((SEATED_POSTURE, "shoes", "feet"), (RECLINED_POSTURE, "feet", "shoes")):
        spec = mujoco.MjSpec()
        person = Person("woman", 0.54)
        human.add_person(spec, person, posture, moving=False)
        add_person_skins(spec, person, posture, open_mouth=False)
        model = spec.compile()
        names = {model.skin(skin).name for skin in range(model.nskin)}
        assert f"person/{worn}" in names
        assert f"person/{bare}" not in names


def test_an_unknown_skin_tone_is_refused() -> None:
    with pytest.raises(ValueError, match="unknown skin tone 'green'; allowed: light, fair, medium"):
        Person(skin_tone="green")
