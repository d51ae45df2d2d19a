import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

import xacro
from avrgym.models.robots import JACO, find_robot, robot_spec
from avrgym.models.scene import robot_with_tool


@pytest.fixture(scope="module")
def jaco() -> mujoco.MjModel:
    return robot_spec(JACO, appearance=False).compile()


def test_the_masses_are_those_of_the_public_description(jaco):
    assert jaco.body_mass.sum() == pytest.approx(xacro.arm_mass(), rel=1e-12)
    by_mesh = xacro.masses()
    for link in range(1, 8):
        mesh = int(xacro.number(f"link_{link}_mesh_no"))
        assert jaco.body(f"link_{link}").mass[0] == by_mesh[mesh]


@pytest.mark.parametrize("joint", JACO.arm_joints)
def test_ranges_and_limits_are_those_of_the_public_description(jaco, joint):
    index = JACO.arm_joints.index(joint)
    limits = [xacro.number(f"{joint}_lower_limit"), xacro.number(f"{joint}_upper_limit")]
    assert_allclose(jaco.joint(joint).range, limits, rtol=1e-12)
    assert_allclose(jaco.actuator(joint).actrange, limits, rtol=1e-12)
    assert JACO.speed_limit_rad_s[index] == pytest.approx(xacro.number(f"{joint}_velocity_limit"))
    assert JACO.torque_limit_n_m[index] == xacro.number(f"{joint}_torque_limit")
    assert_allclose(jaco.actuator(joint).ctrlrange, np.array([-1, 1]) * JACO.speed_limit_rad_s[index])
    assert_allclose(jaco.actuator(joint).forcerange, np.array([-1, 1]) * JACO.torque_limit_n_m[index])


def test_the_seed_pose_lies_within_the_ranges(jaco):
    ranges = np.stack([jaco.joint(joint).range for joint in JACO.arm_joints])
    assert (JACO.seed_pose_rad > ranges[:, 0]).all()
    assert (JACO.seed_pose_rad < ranges[:, 1]).all()


def test_the_servos_are_critically_damped_for_the_inertia_at_the_seed_pose(feeding_stage):
    model = robot_with_tool(feeding_stage, appearance=False).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = JACO.seed_pose_rad
    mujoco.mj_forward(model, data)
    inertia = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, inertia)
    assert_allclose(JACO.inertia_kg_m2, np.diag(inertia), rtol=0.02)
    stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    assert_allclose(damping / (2 * np.sqrt(stiffness * np.diag(inertia))), 1.0, rtol=0.02)


def test_appearance_changes_nothing_that_moves():
    plain, dressed = (robot_spec(JACO, appearance=appearance).compile() for appearance in (False, True))
    assert_allclose(plain.body_mass, dressed.body_mass)
    assert_allclose(plain.body_inertia, dressed.body_inertia)
    assert_allclose(plain.body_pos, dressed.body_pos)
    assert_allclose(plain.body_quat, dressed.body_quat)


def test_an_unknown_robot_names_the_robots():
    with pytest.raises(ValueError, match=r"unknown robot 'R2D2'; the robots are Jaco"):
        find_robot("R2D2")
