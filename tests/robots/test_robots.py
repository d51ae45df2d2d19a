import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial import KDTree

from avrgym.models.robot import build_robot_spec
from avrgym.models.scene import build_robot_with_tool_spec
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.registry import find_robot
from helpers.robots import jaco_xacro

ARM = JACO.arms["right"]
SPOON_GRIP = JACO.grips["spoon"]


@pytest.fixture(scope="module")
def jaco() -> mujoco.MjModel:
    return build_robot_spec(JACO, ARM, appearance=False).compile()


def test_the_masses_are_those_of_the_public_description(jaco):
    assert jaco.body_mass.sum() == pytest.approx(jaco_xacro.arm_mass(), rel=1e-12)
    by_mesh = jaco_xacro.masses()
    for link in range(1, 8):
        mesh = int(jaco_xacro.number(f"link_{link}_mesh_no"))
        assert jaco.body(f"link_{link}").mass[0] == by_mesh[mesh]


@pytest.mark.parametrize("joint", ARM.joints)
def test_ranges_and_limits_are_those_of_the_public_description(jaco, joint):
    index = ARM.joints.index(joint)
    limits = [jaco_xacro.number(f"{joint}_lower_limit"), jaco_xacro.number(f"{joint}_upper_limit")]
    assert_allclose(jaco.joint(joint).range, limits, rtol=1e-12)
    assert_allclose(jaco.actuator(joint).actrange, limits, rtol=1e-12)
    assert ARM.speed_limit[index] == pytest.approx(jaco_xacro.number(f"{joint}_velocity_limit"))
    assert ARM.effort_limit[index] == jaco_xacro.number(f"{joint}_torque_limit")
    assert_allclose(jaco.actuator(joint).ctrlrange, np.array([-1, 1]) * ARM.speed_limit[index])
    assert_allclose(jaco.actuator(joint).forcerange, np.array([-1, 1]) * ARM.effort_limit[index])


def test_the_seed_pose_lies_within_the_ranges(jaco):
    ranges = np.stack([jaco.joint(joint).range for joint in ARM.joints])
    assert (ARM.seed_pose > ranges[:, 0]).all()
    assert (ARM.seed_pose < ranges[:, 1]).all()


def test_the_servos_are_critically_damped_for_the_inertia_at_the_seed_pose(feeding_scene):
    model = build_robot_with_tool_spec(feeding_scene, appearance=False).compile()
    data = mujoco.MjData(model)
    data.qpos[:] = ARM.seed_pose
    mujoco.mj_forward(model, data)
    inertia = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, inertia)
    assert_allclose(ARM.inertia, np.diag(inertia), rtol=0.02)
    stiffness, damping = model.actuator_gainprm[:, 0], -model.actuator_biasprm[:, 2]
    assert_allclose(damping / (2 * np.sqrt(stiffness * np.diag(inertia))), 1.0, rtol=0.02)


def test_appearance_changes_nothing_that_moves():
    plain, dressed = (
        build_robot_spec(JACO, ARM, appearance=appearance).compile() for appearance in (False, True)
    )
    assert_allclose(plain.body_mass, dressed.body_mass)
    assert_allclose(plain.body_inertia, dressed.body_inertia)
    assert_allclose(plain.body_pos, dressed.body_pos)
    assert_allclose(plain.body_quat, dressed.body_quat)


@pytest.mark.parametrize("finger", [1, 2, 3])
def test_the_fingertips_hold_the_handle(grip, finger):
    """Each tip is within 3 mm of the spoon's handle, at angles that the real fingers have."""
    gaps, _ = KDTree(grip["handle"]).query(grip[f"finger_tip_{finger}"])
    assert gaps.min() < 0.003
    assert 0.0 <= SPOON_GRIP.finger_joint_positions[f"finger_{finger}"] <= 1.51
    assert 0.0 <= SPOON_GRIP.finger_joint_positions[f"finger_tip_{finger}"] <= 2.0


def test_the_handle_runs_between_thumb_and_fingers(grip):
    def side(tip: str) -> np.ndarray:
        """Unit vector from the handle to the nearest point of a fingertip."""
        gaps, nearest = map(np.asarray, KDTree(grip["handle"]).query(grip[tip]))
        away = grip[tip][gaps.argmin()] - grip["handle"][nearest[gaps.argmin()]]
        return away / np.linalg.norm(away)

    assert side("finger_tip_1") @ side("finger_tip_2") < -0.5
    assert side("finger_tip_1") @ side("finger_tip_3") < -0.5


@pytest.fixture(scope="module")
def grip(feeding_scene) -> dict[str, np.ndarray]:
    """Points (n, 3) on the skins of the fingertips and of the spoon's handle, metres."""
    model = build_robot_with_tool_spec(feeding_scene, appearance=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    points = {}
    for geom in range(model.ngeom):
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            name = model.body(model.geom_bodyid[geom]).name
            name = "handle" if model.mesh(mesh).name == "spoon_handle_skin" else name
            frame = data.geom_xmat[geom].reshape(3, 3)
            points[name] = _on_surface(model, mesh) @ frame.T + data.geom_xpos[geom]
    return points


def _on_surface(model: mujoco.MjModel, mesh: int) -> np.ndarray:
    """Twelve points along every edge of a mesh's triangles."""
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    corners = vertices[model.mesh_face[model.mesh_faceadr[mesh] :][: model.mesh_facenum[mesh]]]
    share = np.linspace(0.0, 1.0, 12)[:, None, None, None]
    along = share * corners + (1.0 - share) * np.roll(corners, 1, axis=1)
    return along.reshape(-1, 3)


def test_an_unknown_robot_names_the_robots():
    with pytest.raises(ValueError, match=r"unknown robot 'R2D2'; allowed: Jaco"):
        find_robot("R2D2")
