"""The population ``anthropometric``: percentiles and breadths of its source, and room in every seat."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.array_types import FloatArray
from avrgym.models.human import (
    BODIES,
    BODY_DIMENSIONS,
    GIRTH_EXPONENTS,
    REFERENCE_STATURE_M,
    People,
    Person,
    compile_person_model,
    compute_people_layout,
)
from avrgym.people.anthropometric_bodies import ANSUR_II, BMI_RANGE_KG_M2, sample_bodies
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.initial_states import deepest_overlap_m, first_step_forces, reset_episodes

COUNT = 20_000
ANSUR_II_PERCENTILES = {
    "man": {"sitting_height": (0.860, 0.918, 0.977), "arm": (0.581, 0.631, 0.685)},
    "woman": {"sitting_height": (0.803, 0.857, 0.912), "arm": (0.528, 0.574, 0.628)},
}
"""5th, 50th and 95th percentile in metres, of everyone in the survey."""
CORRELATIONS = {"man": (0.78, 0.83, 0.45), "woman": (0.76, 0.82, 0.42)}
"""Stature with sitting height, stature with arm, sitting height with arm."""
BUILDS = [("woman", 1.525, 17.0), ("woman", 1.74, 40.0), ("man", 1.648, 17.0), ("man", 1.87, 40.0)]


@pytest.mark.parametrize("sex", BODY_DIMENSIONS)
def test_percentiles_and_correlations_match_the_source(sex, rng):
    bodies = sample_bodies(np.full(COUNT, sex == "woman"), rng.random(COUNT), rng.random(COUNT))
    survey, usual = ANSUR_II[sex], BODY_DIMENSIONS[sex]
    torso = bodies.torso_height_m / usual.torso_height_m
    sitting, arm = (
        survey.median_sitting_height_m * torso,
        survey.median_arm_length_m * torso * bodies.arm_scale,
    )
    assert bodies.stature_m.min() >= survey.stature_percentiles_m[0]
    assert bodies.stature_m.max() <= survey.stature_percentiles_m[-1]
    inner = 100.0 * (np.array([10.0, 25.0, 50.0, 75.0, 90.0]) - 5.0) / 90.0
    assert_allclose(np.percentile(bodies.stature_m, inner), survey.stature_percentiles_m[1:-1], atol=0.003)
    for name, values in (("sitting_height", sitting), ("arm", arm)):
        low, middle, high = ANSUR_II_PERCENTILES[sex][name]
        assert np.median(values) == pytest.approx(middle, abs=0.003)
        assert np.percentile(values, 5.0) == pytest.approx(low, abs=0.015), "stature ends at its percentiles"
        assert np.percentile(values, 95.0) == pytest.approx(high, abs=0.015)
    found: FloatArray = np.asarray(np.corrcoef([bodies.stature_m, sitting, arm, bodies.bmi_kg_m2]))
    assert_allclose([found[0, 1], found[0, 2], found[1, 2]], CORRELATIONS[sex], atol=0.03)
    assert_allclose(found[3, :3], 0.0, atol=0.03)
    assert_allclose([bodies.bmi_kg_m2.min(), bodies.bmi_kg_m2.max()], BMI_RANGE_KG_M2, atol=0.1)


@pytest.mark.parametrize(("sex", "stature_m", "bmi"), BUILDS)
def test_mass_and_girths_follow_stature_and_body_mass_index(sex, stature_m, bmi):
    person = Person(sex, BODY_DIMENSIONS[sex].torso_height_m, stature_m=stature_m, bmi_kg_m2=bmi)
    model = compile_person_model(person, moving=True)
    assert model.body_mass.sum() == pytest.approx(bmi * stature_m**2)
    built, usual = compute_people_layout(People.from_persons([person])).dimensions, BODY_DIMENSIONS[sex]
    heavier = bmi / (usual.mass_kg / REFERENCE_STATURE_M[sex] ** 2)
    taller = stature_m / REFERENCE_STATURE_M[sex]
    for name, (on_bmi, on_stature) in GIRTH_EXPONENTS.items():
        expected = getattr(usual, name) * heavier**on_bmi * taller**on_stature
        assert_allclose(getattr(built, name), expected, rtol=1e-12)


@pytest.mark.parametrize("sex", BODY_DIMENSIONS)
def test_breadths_and_depths_grow_as_in_the_source(sex):
    """ANSUR II: breadth of the waist grows as BMI to the 0.63, depth of the waist 0.86, hip breadth 0.45."""
    stature_m, torso_m = REFERENCE_STATURE_M[sex], BODY_DIMENSIONS[sex].torso_height_m
    usual = BODY_DIMENSIONS[sex].mass_kg / REFERENCE_STATURE_M[sex] ** 2
    slim, heavy = (
        compute_people_layout(
            People.from_persons([Person(sex, torso_m, stature_m=stature_m, bmi_kg_m2=bmi)])
        ).geom_size
        for bmi in (usual, 36.0)
    )
    for geom, breadth, depth in (("waist", 0.63, 0.86), ("hips", 0.45, 0.65), ("chest", 0.30, 0.63)):
        sizes = [each[geom][0] for each in (slim, heavy)]
        grown = [(2.0 * radius + 2.0 * half, 2.0 * radius) for radius, half, _ in sizes]
        for exponent, (before, after) in zip((breadth, depth), zip(*grown, strict=True), strict=True):
            assert after / before == pytest.approx((36.0 / usual) ** exponent, rel=0.1), geom


def test_people_without_a_build_keep_every_bit():
    person = Person("man", 0.58)
    people = People.from_persons([person, replace(person, stature_m=1.8, bmi_kg_m2=30.0)])
    both, alone = compute_people_layout(people), compute_people_layout(People.from_persons([person]))
    for part in ("geom_size", "geom_pos", "body_pos", "site_pos"):
        for name, values in getattr(alone, part).items():
            assert_array_equal(getattr(both, part)[name][:1], values, err_msg=name)
    assert people.get_person(0).bmi_kg_m2 is None
    assert people.get_person(1).bmi_kg_m2 == 30.0


def test_the_back_keeps_its_place_and_the_belly_moves_forwards():
    slim, heavy = (Person("man", 0.6, stature_m=1.755, bmi_kg_m2=bmi) for bmi in (20.0, 38.0))
    layouts = [compute_people_layout(People.from_persons([each])) for each in (slim, heavy)]
    backs = [each.body_pos["hips"][0, 1] + each.geom_size["chest"][0, 0] for each in layouts]
    assert backs[0] == pytest.approx(backs[1])


@pytest.mark.parametrize(
    "values", [{"stature_m": 1.7}, {"bmi_kg_m2": 20.0}, {"stature_m": 1.7, "bmi_kg_m2": 90.0}]
)
def test_impossible_builds_are_refused(values):
    with pytest.raises(ValueError, match="allowed"):
        Person("man", 0.6, **values)


@pytest.mark.fast_cases(3)
@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_every_body_has_room_at_the_start(environment):
    episodes = reset_episodes(environment, 24, "anthropometric", "none")
    assert deepest_overlap_m(episodes) == 0.0
    assert first_step_forces(episodes).max() == 0.0
    assert episodes.num_initial_state_samples.mean() < 1.5, "hardly any body is rejected"
    assert len(np.unique(episodes.people.bmi_kg_m2)) == 24


def test_capsules_and_mass_of_a_world_follow_its_person():
    for people in ("anthropometric", "revised"):
        episodes = Episodes("avrgym/FeedingJaco-v1", 3, people=people, num_threads=1)
        episodes.reset(np.arange(3), [np.random.default_rng(seed) for seed in range(3)])
        mass, bodies = episodes.simulation.batch.expanded("body_mass"), [f"person/{name}" for name in BODIES]
        assert mass is not None
        rows = [episodes.simulation.model.body(name).id for name in bodies]
        layout = compute_people_layout(episodes.people, episodes.scene.posture)
        expected = np.broadcast_to(layout.dimensions.mass_kg, 3)
        assert_allclose(mass[:, rows].sum(axis=1), expected)
