"""Forces by region of the body: whose they are, that they add up, and when they are too much."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.models import collision_bits, human
from avrgym.models.scene import DEFAULT_SUBSTEPS, PHYSICS_STEP_S
from avrgym.safety.limits import (
    BODY_REGIONS,
    MAX_TRANSIENT_DURATION_S,
    QUASI_STATIC_LIMIT_N,
    REGION_INDEX_OF_GEOM,
    TRANSIENT_LIMIT_N,
)
from avrgym.safety.region_forces import MAX_GEOM_CONTACTS, RegionLoadRecorder, RegionLoads
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.contact_forces import actions_towards
from helpers.simulation.initial_states import reset_episodes

SCRATCHING = "avrgym/ScratchItchJaco-v1"
WORLDS = 12
TRANSIENT_STEPS = round(MAX_TRANSIENT_DURATION_S / PHYSICS_STEP_S)
REGIONS = [region.name for region in BODY_REGIONS]


def driven(environment: str, steps: int, *, people: str = "revised") -> Episodes:
    """Robots driven at the people for so many control steps."""
    episodes = reset_episodes(environment, WORLDS, people, by_region=True)
    aim = np.arange(WORLDS) % 4
    for _ in range(steps):
        episodes.step(actions_towards(episodes, aim))
    return episodes


def test_each_part_of_the_body_is_of_one_region():
    geoms = [geom for region in BODY_REGIONS for geom in region.geoms]
    assert sorted(geoms) == sorted(human.GEOMS)
    assert len(set(REGIONS)) == len(BODY_REGIONS)
    assert (TRANSIENT_LIMIT_N >= QUASI_STATIC_LIMIT_N).all()
    head = [region for region in BODY_REGIONS if region.name in ("skull", "face")]
    assert [region.transient_limit_n for region in head] == [130.0, 65.0]


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("environment", ["avrgym/FeedingPR2-v1", SCRATCHING, "avrgym/DrinkingJaco-v1"])
@pytest.mark.parametrize("people", ["revised", "participants"])
def test_measuring_forces_changes_no_bit(environment, people, rng):
    plain, measured = (
        reset_episodes(environment, 4, people, by_region=by_region) for by_region in (False, True)
    )
    for action in rng.uniform(-1.0, 1.0, (8, 4, 7)):
        one = plain.step(action)
        measured.command_robots(action)
        for substep in range(DEFAULT_SUBSTEPS):
            measured.step_physics(substep, 1)
            measured.simulation.compute_region_force_n()
        other = measured.evaluate_step(action)
        for name in ("observation", "reward", "force_on_person_n", "distance_m", "success"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    for world in range(4):
        one, other = (each.simulation.get_integration_state(world) for each in (plain, measured))
        assert_array_equal(one, other)


def test_nobody_is_asked_who_does_not_measure():
    with pytest.raises(RuntimeError, match="by_region=True"):
        reset_episodes(SCRATCHING, 1).simulation.compute_region_force_n()


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_robots_at_rest_press_nobody(environment):
    episodes = reset_episodes(environment, 2, "original", by_region=True)
    episodes.step(np.zeros((2, episodes.action_size)))
    assert not episodes.simulation.get_state().total_force_n.any()
    assert not episodes.simulation.compute_region_force_n().any()


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", SCRATCHING, "avrgym/BedBathingPR2-v1"])
def test_regions_bear_together_what_the_person_bears(environment):
    episodes, aim = reset_episodes(environment, WORLDS, "participants", by_region=True), np.arange(WORLDS) % 4
    pressed = 0
    for _ in range(40):
        episodes.step(actions_towards(episodes, aim))
        total_n = episodes.simulation.get_state().total_force_n
        force_n = episodes.simulation.compute_region_force_n()
        assert_allclose(force_n.sum(axis=-1), total_n, rtol=1e-12, atol=1e-12)
        assert (force_n >= 0.0).all()
        pressed += int((total_n > 1.0).sum())
    assert pressed > 20


@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", SCRATCHING])
def test_the_pressed_region_is_the_one_that_touches(environment):
    """Contact by contact, as MuJoCo lists them."""
    episodes = driven(environment, 30)
    simulation = episodes.simulation
    simulation.batch.forward()
    force_n, found = simulation.compute_region_force_n(), 0
    for world in range(WORLDS):
        expected, most = by_contact(simulation.batch, world)
        assert_allclose(force_n[world], expected, rtol=1e-9, atol=1e-9)
        assert most <= MAX_GEOM_CONTACTS
        found += int((expected > 1.0).sum())
    assert found >= 4


def by_contact(batch: mujoco.batch.Batch, world: int) -> tuple[np.ndarray, int]:
    """The forces (R,) on one person's regions, and the most contacts of a part of their body with the robot."""
    model, data = batch.get_model(world), batch.get_data(world)
    force_n, count = np.zeros(len(BODY_REGIONS)), dict.fromkeys(human.GEOMS, 0)
    for number, contact in enumerate(data.contact):
        mine = [geom for geom in contact.geom if model.geom_contype[geom] == collision_bits.PERSON.contype]
        by_robot = [
            geom
            for geom in contact.geom
            if model.geom_contype[geom]
            in (collision_bits.ROBOT.contype, collision_bits.TOOL.contype, collision_bits.HULL.contype)
        ]
        if mine and by_robot:
            wrench = np.zeros(6)
            mujoco.mj_contactForce(model, data, number, wrench)
            geom = model.geom(mine[0]).name.removeprefix(human.PERSON_NAME_PREFIX)
            force_n[REGION_INDEX_OF_GEOM[geom]] += np.linalg.norm(wrench[:3])
            count[geom] += 1
    return force_n, max(count.values())


def loads(force_n: np.ndarray) -> RegionLoads:
    """Of forces (T, R) on one person, step by step."""
    watch = RegionLoadRecorder(1)
    for read_forces_n in force_n:
        watch.add_forces(read_forces_n[None])
    return watch.compute_loads()


def test_a_force_counts_as_held_when_it_lasts_longer_than_half_a_second():
    for steps, held in ((TRANSIENT_STEPS, False), (TRANSIENT_STEPS + 1, True)):
        force_n = np.zeros((120, len(BODY_REGIONS)))
        force_n[20 : 20 + steps] = QUASI_STATIC_LIMIT_N + 0.1
        found = loads(force_n)
        assert found.over_quasi_static_limit_mask.all() == found.over_quasi_static_limit_mask.any() == held
        assert_allclose(found.max_overload_duration_s, steps * PHYSICS_STEP_S)
    force_n[40] = QUASI_STATIC_LIMIT_N
    assert not loads(force_n).over_quasi_static_limit_mask.any()


def test_nothing_is_over_a_limit_that_only_reaches_it():
    force_n = np.tile(QUASI_STATIC_LIMIT_N, (200, 1))
    assert not loads(force_n).over_limit_mask.any()
    force_n[7] = TRANSIENT_LIMIT_N
    assert not loads(force_n).over_limit_mask.any()
    force_n[7] *= 1.001
    assert loads(force_n).over_transient_limit_mask.all()
    assert not loads(force_n).over_quasi_static_limit_mask.any()


def test_loads_sum_up_what_was_borne(rng):
    force_n = np.maximum(rng.normal(0.0, 50.0, (60, len(BODY_REGIONS))), 0.0)
    found = loads(force_n)
    assert_allclose(found.mean_force_n[0], force_n.mean(axis=0))
    assert_array_equal(found.peak_force_n[0], force_n.max(axis=0))
    assert_allclose(found.contact_time_fraction[0], (force_n > 0.0).mean(axis=0))
    concatenate = RegionLoads.concatenate([found, loads(force_n[:7])])
    assert_array_equal(concatenate.peak_force_n, [force_n.max(axis=0), force_n[:7].max(axis=0)])
