"""The paper's equations of section III and ours: the results of docs/explanation/body_alignment.md."""

import runpy

import mujoco
import numpy as np
import pytest

from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import SEATED_POSTURE, Person
from helpers.system.paths import ROOT

EXAMPLE = runpy.run_path(str(ROOT / "scripts" / "figures" / "body_alignment.py"))
WAYS, HEADS = EXAMPLE["WAYS"], EXAMPLE["people_in_poses"](np.random.default_rng(1), 1500)
PAPER, REFERENCE, OURS = WAYS


def median_errors(way: str) -> tuple[float, float]:
    """Millimetres and degrees."""
    away_m, turned_rad = EXAMPLE["errors"](WAYS[way], HEADS)
    return 1000.0 * float(np.median(away_m)), float(np.degrees(np.median(turned_rad)))


def test_ours_brings_the_head_exactly_to_its_pose():
    away_m, turned_rad = EXAMPLE["errors"](WAYS[OURS], HEADS)
    assert away_m.max() < 1e-9
    assert turned_rad.max() < 1e-6


def test_the_papers_equations_miss_by_centimetres_and_tens_of_degrees():
    away_mm, turned_deg = median_errors(PAPER)
    assert 25.0 < away_mm < 35.0
    assert 17.0 < turned_deg < 24.0


def test_to_subtract_the_waists_angles_helps_and_is_not_exact():
    (away_mm, turned_deg), (paper_mm, paper_deg) = median_errors(REFERENCE), median_errors(PAPER)
    assert 10.0 < away_mm < paper_mm
    assert 2.0 < turned_deg < paper_deg


@pytest.mark.parametrize("way", WAYS)
def test_upright_people_who_look_ahead_are_upright(way):
    """All agree where nothing bends, and so where the equations' conventions have their zeros."""
    for height_m in (0.46, 0.60):
        person = Person("man", height_m)
        head = EXAMPLE["head_of"](person, np.zeros(6))
        np.testing.assert_allclose(WAYS[way](person, head), 0.0, atol=1e-9)


def test_the_heads_of_the_comparison_are_those_of_the_simulated_body(rng):
    for sex in human.SEXES:
        person = Person(sex, 0.57)
        model = human.compile_person_model(person, SEATED_POSTURE, moving=True)
        data, angles_rad = mujoco.MjData(model), rng.uniform(-0.4, 0.4, 6)
        driven = [human.JOINT_INDEX[f"{part}_{axis}"] for part in ("waist", "head") for axis in "xyz"]
        data.qpos[driven] = angles_rad
        mujoco.mj_kinematics(model, data)
        head = EXAMPLE["head_of"](person, angles_rad)
        np.testing.assert_allclose(
            head.pos_w, data.site(f"{human.PERSON_NAME_PREFIX}head_centre").xpos, atol=1e-9
        )
        assert transforms.angle_between(head.q_w, data.body(f"{human.PERSON_NAME_PREFIX}head").xquat) < 1e-6
