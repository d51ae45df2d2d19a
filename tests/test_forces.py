"""No motor here presses harder than it can, and a person gives way: what robots may press people with."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.models import human, robots
from avrgym.models.robots import ROBOTS
from avrgym.models.yielding import (
    GIVEN_WAY_M,
    INVERSE_MASS_PER_KG,
    MOST_CONTACT_FORCE_N,
    contact_force_n,
    torque_limit_n_m,
)
from avrgym.simulation.worlds import MAX_LEAD_RAD, Simulation
from avrgym.tasks import TASKS
from forces import MOST_FORCE_N, pressed
from starts import at_once, begun

SCRATCHING = "avrgym/ScratchItchJaco-v1"


def test_the_force_of_a_contact_grows_and_then_gives_way():
    depths = np.linspace(0.0, GIVEN_WAY_M, 200)
    force = contact_force_n(depths)
    assert force[0] == 0.0
    assert force[1] / depths[1] == pytest.approx(40e3, rel=0.05)
    assert pytest.approx(100.0, abs=1.0) == MOST_CONTACT_FORCE_N
    assert (np.diff(force[depths < 0.015]) > 0.0).all()
    assert (np.diff(force[depths > 0.02]) < 0.0).all()


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=lambda robot: robot.name)
def test_motors_press_with_no_more_than_their_lead_nor_than_they_have(robot):
    stage = TASKS["Feeding"].stage(robot)
    model = Simulation(stage, 1, num_threads=1).model
    ranges = np.array([model.actuator(robots.PREFIX + joint).forcerange for joint in stage.arm.joints])
    limit = torque_limit_n_m(stage.arm, MAX_LEAD_RAD)
    assert_allclose(ranges, np.stack([-limit, limit], axis=-1))
    assert (limit <= stage.arm.torque_limit_n_m).all()
    assert (limit <= MAX_LEAD_RAD * stage.arm.stiffness_n_m_rad).all()


def test_a_hand_inside_a_link_that_cannot_give_way_is_pressed_as_by_flesh():
    """Even where a start is false, no solver makes 10⁸ N of it: link 2 stands in the hand and cannot go anywhere."""
    old, new = (begun(SCRATCHING, 128, "revised", "limits", world_version=version) for version in (1, 2))
    new._room = None
    new.begin(np.arange(128), [np.random.default_rng(seed) for seed in range(128)])
    assert_allclose(new.simulation.geoms(np.arange(128)).pos_w, old.simulation.geoms(np.arange(128)).pos_w)
    assert at_once(old).max() > 1e6
    assert 1.0 < at_once(new).max() < MOST_FORCE_N


@pytest.mark.parametrize("task", ["Feeding", "ScratchItch", "BedBathing"])
@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("how", ["constant", "at the person"])
def test_no_jam_grows(task, robot, how):
    """Arms that push on for 6 s, every joint one way, or straight at the person."""
    peak = pressed(f"avrgym/{task}{robot}-v1", 24, "revised", "none", how, steps=60)
    assert peak.max() < MOST_FORCE_N


def test_jams_grew_in_version_1():
    assert pressed(SCRATCHING, 48, "revised", "none", "constant", steps=60, world_version=1).max() > 1000.0


def test_people_who_do_not_move_give_way_as_softly_as_they_would_alone():
    """The softness of a person's contacts does not depend on the sex or the size of who sat there before."""
    episodes = begun(SCRATCHING, 4)
    bodies = [episodes.simulation.model.body(human.PREFIX + name).id for name in human.BODIES]
    for _ in range(2):
        episodes.begin(np.arange(4), [np.random.default_rng(seed) for seed in range(4)])
        softness = episodes.simulation.batch.get_model(2).body_invweight0[bodies, 0]
        assert_allclose(softness, INVERSE_MASS_PER_KG)
