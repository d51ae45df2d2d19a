"""Motor limits and compliance of people: bounds of contact forces."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.models import collision_bits, human
from avrgym.models.compliance import (
    MAX_CONTACT_DEPTH_M,
    MAX_CONTACT_FORCE_N,
    PERSON_INVERSE_MASS_PER_KG,
    TREMOR_STRENGTH_FRACTION,
    compute_contact_force_n,
    compute_effective_effort_limits,
    compute_impact_force_n,
    set_compliance,
)
from avrgym.models.robot import ROBOT_NAME_PREFIX
from avrgym.models.scene import SCENE_TOOL_BODY
from avrgym.robots.registry import ROBOTS
from avrgym.simulation.worlds import MAX_SERVO_LEAD_RAD, Simulation
from avrgym.tasks.registry import TASKS
from helpers.simulation.contact_forces import MAX_FORCE_N, peak_forces
from helpers.simulation.initial_states import first_step_forces, reset_episodes

SCRATCHING = "avrgym/ScratchItchJaco-v1"
STRIKE = """
<mujoco>
  <option gravity="0 0 0" timestep="0.01"/>
  <worldbody>
    <body name="head"><geom name="head" size="0.09"/></body>
    <body name="ball" pos="0.0999999 0 0">
      <joint type="slide" axis="1 0 0"/>
      <geom name="ball" size="0.01"/>
    </body>
  </worldbody>
</mujoco>
"""


def test_a_person_is_a_spring_that_gives_way_ever_more():
    depths = np.linspace(0.0, MAX_CONTACT_DEPTH_M, 501)
    force = compute_contact_force_n(depths)
    assert force[0] == 0.0
    assert compute_contact_force_n(np.array(1e-5)) / 1e-5 == pytest.approx(25.5e3, rel=0.03)
    assert force[-1] == pytest.approx(101.4, abs=0.1) == MAX_CONTACT_FORCE_N
    assert (np.diff(force) > 0.0).all()
    assert (np.diff(force[depths < 0.02], n=2) < 0.0).all()


@pytest.mark.parametrize("depth_m", [0.0002, 0.002, 0.02, 0.06])
def test_mujoco_carries_what_the_curve_says(depth_m):
    spec = mujoco.MjSpec.from_string(STRIKE)
    set_compliance(spec.geom("head"))
    spec.geom("ball").mass = 1e6
    spec.body("ball").pos[0] = 0.1 - depth_m
    model = spec.compile()
    model.body_invweight0[model.body("head").id, 0] += PERSON_INVERSE_MASS_PER_KG
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.efc_force.sum() == pytest.approx(float(compute_contact_force_n(np.array(depth_m))), rel=0.001)


@pytest.mark.parametrize("mass_kg", [0.1, 1.0, 10.0, 100.0])
@pytest.mark.parametrize("speed_m_s", [0.1, 1.0])
def test_what_strikes_presses_as_its_energy_allows(mass_kg, speed_m_s):
    """A ball touches a person's head that cannot move; its force is that of the speed alone."""
    spec = mujoco.MjSpec.from_string(STRIKE)
    set_compliance(spec.geom("head"))
    spec.geom("ball").mass = mass_kg
    model = spec.compile()
    model.body_invweight0[model.body("head").id, 0] += PERSON_INVERSE_MASS_PER_KG
    data = mujoco.MjData(model)
    data.qvel[0] = -speed_m_s
    mujoco.mj_forward(model, data)
    strike = float(compute_impact_force_n(np.array(0.5 * mass_kg * speed_m_s**2)))
    assert data.ncon == 1
    assert 0.0 < data.efc_force.sum() <= strike


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_motors_press_with_no_more_than_their_lead_nor_than_they_have(robot):
    scene = TASKS["Feeding"].make_scene(robot)
    simulation = Simulation(scene, 1, num_threads=1)
    model, lead = (
        simulation.model,
        MAX_SERVO_LEAD_RAD * simulation.configuration_scales[: len(scene.arm.joints)],
    )
    ranges = np.array([model.actuator(ROBOT_NAME_PREFIX + joint).forcerange for joint in scene.arm.joints])
    limit = compute_effective_effort_limits(scene.arm, lead)
    assert_allclose(ranges, np.stack([-limit, limit], axis=-1))
    assert (limit <= scene.arm.effort_limit).all()
    assert (limit <= lead * scene.arm.stiffness).all()


def test_who_trembles_presses_with_a_third_of_the_strength():
    trembling, calm = (
        reset_episodes(SCRATCHING, 2, impairment="tremor"),
        reset_episodes(SCRATCHING, 2, impairment="weakness"),
    )
    for episodes, share in ((trembling, TREMOR_STRENGTH_FRACTION), (calm, 1.0)):
        model = episodes.simulation.batch.get_model(1)
        ranges = [model.actuator(human.PERSON_NAME_PREFIX + joint).forcerange[1] for joint in human.JOINTS]
        assert_allclose(ranges, share * episodes.people.strength_share[1] * human.JOINT_TORQUE_LIMITS_N_M)


def test_people_touch_a_box_in_place_of_the_spoons_thin_walls():
    model = Simulation(TASKS["Feeding"].make_scene(ROBOTS["Jaco"]), 1, num_threads=1).model
    touching = (model.geom_conaffinity & collision_bits.PERSON.contype) & (
        model.geom_bodyid == model.body(SCENE_TOOL_BODY).id
    )
    names = [model.geom(geom).name for geom in np.nonzero(touching)[0]]
    assert names == ["robot/spoon_handle", "robot/hull"]


def test_a_hand_inside_a_link_that_cannot_give_way_is_pressed_as_by_flesh():
    """Even where a start is false, no solver makes 10⁸ N of it: link 2 stands in the hand and cannot go anywhere."""
    episodes = reset_episodes(SCRATCHING, 128, "revised", "limits", checked=False)
    assert 1.0 < first_step_forces(episodes).max() < MAX_FORCE_N


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("task", ["Feeding", "ScratchItch", "BedBathing", "ArmManipulation"])
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("how", ["constant", "at the person"])
def test_no_jam_grows(task, robot, how):
    """Arms that push on for 6 s, every joint one way, or straight at the person."""
    peak = peak_forces(f"avrgym/{task}{robot}-v1", 24, "revised", "none", how, steps=60)
    assert peak.max() < MAX_FORCE_N


@pytest.mark.parametrize("task", ["Feeding", "BedBathing"])
@pytest.mark.fast_cases(1)
def test_people_who_tremble_are_not_jammed_either(task):
    peak = peak_forces(f"avrgym/{task}PR2-v1", 24, "participants", "tremor", "at the person", steps=40)
    assert peak.max() < MAX_FORCE_N


def test_people_who_do_not_move_give_way_as_softly_as_they_would_alone():
    """The softness of a person's contacts does not depend on sex or size of the person before."""
    episodes = reset_episodes(SCRATCHING, 4)
    bodies = [episodes.simulation.model.body(human.PERSON_NAME_PREFIX + name).id for name in human.BODIES]
    for _ in range(2):
        episodes.reset(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
        softness = episodes.simulation.batch.get_model(2).body_invweight0[bodies, 0]
        assert_allclose(softness, PERSON_INVERSE_MASS_PER_KG)
