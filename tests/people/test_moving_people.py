"""The static and the moving person have the same body, pose and weight."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.models import human
from avrgym.models.human import JOINTS, Person
from avrgym.models.scene import build_scene_spec
from avrgym.simulation.person_model_fields import INERTIAL_FIELDS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS

WORLDS = 4
ARRIVED = 8
"""Control steps after which an arm that nothing holds has arrived."""


def reset_episodes(environment: str, *, moving: bool) -> Episodes:
    episodes = Episodes(environment, WORLDS, people="revised", moving=moving, num_threads=1)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng(i) for i in range(WORLDS)])
    return episodes


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.fast_cases(4)
def test_static_and_moving_people_have_head_and_arm_in_the_same_place(environment):
    static, moving = (
        reset_episodes(environment, moving=moves).simulation.get_state() for moves in (False, True)
    )
    for part in ("head_pos_w", "head_quat_w", "mouth_pos_w", "right_arm_pos_w", "right_arm_quat_w"):
        assert_allclose(getattr(moving, part), getattr(static, part), atol=1e-6, err_msg=part)
    assert_allclose(moving.person_capsule_ends_w, static.person_capsule_ends_w, atol=1e-6)
    assert_allclose(moving.person_radius_m, static.person_radius_m, atol=1e-12)


@pytest.mark.parametrize("environment", ["avrgym/FeedingJaco-v1", "avrgym/BedBathingJaco-v1"])
def test_per_world_fields_equal_the_compiled_person(environment):
    episodes = reset_episodes(environment, moving=True)
    for world in range(WORLDS):
        person = episodes.get_person(world)
        alone = build_scene_spec(episodes.scene, person, moving=True, appearance=False).compile()
        here = episodes.simulation.batch.get_model(world)
        bodies = [alone.body(human.PERSON_NAME_PREFIX + name).id for name in human.BODIES]
        for field in (*INERTIAL_FIELDS, "body_pos", "body_quat"):
            expected, found = getattr(alone, field)[bodies], getattr(here, field)[bodies]
            assert_allclose(found, expected, atol=1e-12, err_msg=field)
        actuators = [alone.actuator(human.PERSON_NAME_PREFIX + name).id for name in JOINTS]
        assert_allclose(here.actuator_forcerange[actuators], alone.actuator_forcerange[actuators])


@pytest.mark.parametrize("sex", human.SEXES)
@pytest.mark.parametrize("torso_height_m", [0.40, 0.54, 0.75])
def test_static_and_moving_people_weigh_the_same_in_every_part(sex, torso_height_m):
    models = []
    for moving in (False, True):
        person = Person(sex, torso_height_m)
        episodes = Episodes("avrgym/FeedingJaco-v1", 2, person=person, moving=moving, num_threads=1)
        episodes.reset(np.arange(2), [np.random.default_rng(i) for i in range(2)])
        models.append(episodes.simulation.batch.get_model(1))
    for name in human.BODIES:
        static, moving = (model.body(human.PERSON_NAME_PREFIX + name) for model in models)
        assert_allclose(static.mass, moving.mass, rtol=1e-12, err_msg=name)
        assert_allclose(static.subtreemass, moving.subtreemass, rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("moving", [False, True])
def test_the_whole_body_weighs_what_the_table_says(moving):
    episodes = reset_episodes("avrgym/FeedingJaco-v1", moving=moving)
    for world in range(WORLDS):
        model = episodes.simulation.batch.get_model(world)
        mass = sum(float(model.body(human.PERSON_NAME_PREFIX + name).mass[0]) for name in human.BODIES)
        sex = episodes.get_person(world).sex
        assert mass == pytest.approx(human.BODY_DIMENSIONS[sex].mass_kg, rel=1e-9)


def test_robot_and_arm_move_each_other():
    """A person's hand that wants to go through the robot's arm moves it, and is held off."""
    episodes = reset_episodes("avrgym/FeedingJaco-v1", moving=True)
    simulation = episodes.simulation
    targets = episodes.people.joint_angles_rad.copy()
    reach = [human.JOINT_INDEX["right_shoulder_x"], human.JOINT_INDEX["right_elbow_x"]]
    targets[:, reach] = np.radians([-75.0, -10.0])
    simulation.command_person(targets)
    before, felt, held_off = simulation.get_state(), np.zeros(WORLDS), np.zeros(WORLDS)
    for step in range(30):
        episodes.step(np.zeros((WORLDS, 7)))
        felt = np.maximum(felt, simulation.get_state().robot_force_n)
        if step >= ARRIVED:
            short_of = np.abs(simulation.get_person_joint_angles_rad() - targets)[:, reach].max(axis=1)
            held_off = np.maximum(held_off, short_of)
    pushed = felt > 1.0
    assert pushed.any()
    assert not pushed.all()
    moved = np.abs(simulation.get_state().joint_positions - before.joint_positions).max(axis=1)
    for measured in (moved, held_off):
        assert (measured[pushed] > 0.005).all()
        assert (measured[~pushed] < 0.005).all()
