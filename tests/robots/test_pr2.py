"""The PR2's model against its public description."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.geometry import kinematics, transforms
from avrgym.models.body_names import Side
from avrgym.models.robot import build_robot_spec
from avrgym.models.scene import PHYSICS_STEP_S
from avrgym.robots.jaco.robot import JACO
from avrgym.robots.pr2.robot import MESH_FOLDER, PR2
from helpers.robots import pr2_urdf

SIDES: tuple[Side, ...] = ("right", "left")
MIRROR_SIGNS = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""How the angles of an arm mirror those of the other."""
FLIP_Y = np.diag([1.0, -1.0, 1.0])
HEAD_TILT_RAD = 0.35
COUNT = 1000


@pytest.fixture(scope="module")
def description() -> pr2_urdf.Description:
    return pr2_urdf.read(MESH_FOLDER.parent / "robots" / "pr2.urdf.xacro")


@pytest.fixture(scope="module")
def models() -> dict[Side, mujoco.MjModel]:
    """The PR2 by its moving arm."""
    models: dict[Side, mujoco.MjModel] = {}
    for side in SIDES:
        models[side] = build_robot_spec(PR2, PR2.arms[side], appearance=False).compile()
        models[side].opt.timestep = PHYSICS_STEP_S
        models[side].opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return models


@pytest.fixture(scope="module")
def dressed() -> mujoco.MjModel:
    return build_robot_spec(PR2, PR2.arms["right"], appearance=True).compile()


@pytest.fixture(scope="module")
def chains(models) -> dict[Side, kinematics.Chain]:
    """From the base to the hand."""
    return {side: chain(models[side], side) for side in SIDES}


def chain(model: mujoco.MjModel, side: Side) -> kinematics.Chain:
    arm = PR2.arms[side]
    return kinematics.extract_chain(model, arm.joints, PR2.base, arm.end_effector)


def within_ranges(rng: np.random.Generator, chain: kinematics.Chain) -> np.ndarray:
    return rng.uniform(chain.lower_limit, chain.upper_limit, (COUNT, 7))


def raised(model: mujoco.MjModel, description: pr2_urdf.Description) -> float:
    """How far the torso is raised, metres."""
    pos, _ = description.pose(PR2.torso, "base_footprint", {})
    return float((model.body(PR2.torso).pos - pos)[2])


def rotation_error(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(transforms.to_matrix(a) - transforms.to_matrix(b)).max())


# Places


@pytest.mark.parametrize("side", SIDES)
def test_the_hand_is_where_the_description_has_it(rng, side, chains, models, description):
    angles = within_ranges(rng, chains[side])
    found_pos, found_q = kinematics.forward_kinematics(chains[side], angles)
    values = dict(zip(PR2.arms[side].joints, angles.T, strict=True))
    values["torso_lift_joint"] = np.array(raised(models[side], description))
    pos, q = description.pose(PR2.arms[side].end_effector, "base_footprint", values)
    assert_allclose(found_pos, pos, atol=1e-6)
    assert rotation_error(found_q, q) < 1e-6


@pytest.mark.parametrize("side", SIDES)
def test_all_that_does_not_move_is_where_the_description_has_it(side, models, description):
    """The other arm at the angles of the reference, the head looking down, the hands closed."""
    model, data = models[side], mujoco.MjData(models[side])
    mujoco.mj_kinematics(model, data)
    holding = {
        joint: np.array(angle) for joint, angle in PR2.fixed_joint_positions.items() if joint[0] != side[0]
    }
    lift = np.array(raised(model, description))
    values = holding | {"torso_lift_joint": lift, "head_tilt_joint": np.array(HEAD_TILT_RAD)}
    for body in (model.body(i).name for i in range(2, model.nbody)):
        if not body.startswith(side[0] + "_"):
            pos, q = description.pose(body, "base_footprint", values)
            assert_allclose(data.body(body).xpos, pos, atol=1e-6)
            assert rotation_error(data.body(body).xquat, q) < 1e-6


def test_the_arms_rest_as_in_the_reference():
    left = [1.75, 1.25, 1.5, -0.5, 1.0, 0.0, 1.0]
    assert_array_equal([PR2.fixed_joint_positions[joint] for joint in PR2.arms["left"].joints], left)
    right = [-1.75, 1.25, -1.5, -0.5, -1.0, 0.0, -1.0]
    assert_array_equal([PR2.fixed_joint_positions[joint] for joint in PR2.arms["right"].joints], right)


def test_the_torso_is_raised_as_far_as_it_may(models, description):
    limits = description.joints["torso_lift_joint"].limits
    assert limits["lower"] + 0.0115 <= raised(models["right"], description) <= limits["upper"] - 0.005


@pytest.mark.parametrize("pose", ["random", "seed", "holding"])
def test_right_and_left_mirror_each_other(rng, pose, chains):
    right, left = chains["right"], chains["left"]
    angles = {
        "random": (MIRROR_SIGNS * (lefts := within_ranges(rng, left)), lefts),
        "seed": (PR2.arms["right"].seed_pose[None], PR2.arms["left"].seed_pose[None]),
        "holding": tuple(
            np.array([[PR2.fixed_joint_positions[joint] for joint in PR2.arms[side].joints]])
            for side in SIDES
        ),
    }[pose]
    (right_pos, right_q), (left_pos, left_q) = (
        kinematics.forward_kinematics(*pair) for pair in zip((right, left), angles, strict=True)
    )
    assert_allclose(right_pos, left_pos @ FLIP_Y, atol=1e-12)
    mirrored = FLIP_Y @ transforms.to_matrix(left_q) @ FLIP_Y
    assert_allclose(transforms.to_matrix(right_q), mirrored, atol=1e-12)


# What it weighs


def test_every_body_weighs_what_its_links_do(models, description):
    """A body stands for the links that it is named after and carries rigidly."""
    model = models["right"]
    bodies = {link_name(model.body(i).name): model.body(i) for i in range(1, model.nbody)}
    carried: dict[str, list[str]] = {name: [] for name in bodies}
    for link in description.links:
        carrier = link
        while carrier not in bodies:
            carrier = description.joints[description.joint_above(carrier)].parent
        carried[carrier].append(link)
    for name in [name for name in bodies if not name.endswith("tool_frame")]:
        body, expected = bodies[name], description.rigid_union(name, carried[name])
        frame = transforms.to_matrix(body.iquat)
        assert body.mass[0] == pytest.approx(expected.mass, rel=1e-9)
        assert_allclose(body.ipos, expected.com, atol=1e-9)
        assert_allclose(frame @ np.diag(body.inertia) @ frame.T, expected.inertia, rtol=1e-6, atol=1e-9)


def link_name(body: str) -> str:
    """The link that a body is named after; the base's frame is on the floor."""
    return "base_footprint" if body == PR2.base else body


@pytest.mark.parametrize("side", SIDES)
def test_it_weighs_as_much_as_the_description(side, models, description):
    mass = sum(link.mass for link in description.links.values())
    assert models[side].body_mass.sum() == pytest.approx(mass, rel=1e-9)


def test_appearance_changes_nothing_that_moves(models, dressed):
    for name in ("body_mass", "body_inertia", "body_pos", "body_quat", "jnt_range", "actuator_gainprm"):
        assert_array_equal(getattr(models["right"], name), getattr(dressed, name))


# How it moves


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("index", range(7))
def test_ranges_and_limits_are_those_of_the_description(side, index, models, description):
    """Continuous joints end at two turns, and speeds at the Jaco's, which are slower."""
    arm, joint = PR2.arms[side], PR2.arms[side].joints[index]
    limits = description.joints[joint].limits
    turns = {"lower": -2.0 * np.pi, "upper": 2.0 * np.pi}
    bounds = [limits[end] if description.joints[joint].kind == "revolute" else turns[end] for end in turns]
    actuator = models[side].actuator(joint)
    assert_allclose(models[side].joint(joint).range, bounds, rtol=1e-12)
    assert_allclose(actuator.actrange, bounds, rtol=1e-12)
    speed = min(limits["velocity"], JACO.arms[side].speed_limit[index])
    assert_allclose(actuator.ctrlrange, np.array([-1, 1]) * speed)
    assert_allclose(actuator.forcerange, np.array([-1, 1]) * limits["effort"])
    assert arm.speed_limit[index] == speed


@pytest.mark.parametrize("side", SIDES)
def test_only_one_arm_moves(side, models):
    assert [models[side].joint(i).name for i in range(models[side].njnt)] == list(PR2.arms[side].joints)


@pytest.mark.parametrize("side", SIDES)
def test_the_servos_are_critically_damped_for_the_inertia_at_the_seed_pose(side, models):
    arm, model, data = PR2.arms[side], models[side], mujoco.MjData(models[side])
    data.qpos[:] = arm.seed_pose
    mujoco.mj_forward(model, data)
    inertia = np.zeros((7, 7))
    mujoco.mj_fullM(model, data, inertia)
    assert_allclose(arm.inertia, np.diag(inertia), rtol=0.02)


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("index", range(7))
def test_a_joint_follows_its_command_and_stops(side, index, models):
    """At full speed it lags 0.11 s or less; it does not swing past its target, and moves nothing else."""
    arm, model = PR2.arms[side], models[side]
    data = mujoco.MjData(model)
    data.qpos[:], data.act[:] = arm.seed_pose, arm.seed_pose
    data.ctrl[index] = arm.speed_limit[index]
    mujoco.mj_step(model, data, 80)
    assert data.act[index] - data.qpos[index] < 0.115 * data.ctrl[index]
    data.ctrl[index] = 0.0
    highest = max(_stepped(model, data)[index] for _ in range(100))
    assert highest - data.act[index] < np.radians(0.1)
    assert_allclose(data.qpos, data.act, atol=np.radians(0.1))


def _stepped(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    mujoco.mj_step(model, data)
    return data.qpos


@pytest.mark.parametrize("side", SIDES)
def test_the_hand_reaches_all_around_from_the_seed_pose(rng, side, chains):
    """Pointing forwards, in a box of 25 × 40 × 60 cm before the robot, within 5 mm and 0.05 rad."""
    out = np.array([1.0, -1.0 if side == "right" else 1.0, 1.0])
    pos = out * rng.uniform([0.5, 0.0, 0.7], [0.75, 0.4, 1.3], (100, 3))
    forwards = np.tile(transforms.IDENTITY_QUATERNION, (100, 1))
    start = np.tile(PR2.arms[side].seed_pose, (100, 1))
    solution = kinematics.inverse_kinematics(chains[side], pos, forwards, start)
    assert solution.position_error_m.max() < kinematics.MAX_POSITION_ERROR_M
    assert solution.rotation_error_rad.max() < kinematics.MAX_ROTATION_ERROR_RAD


# How it looks


def points(model: mujoco.MjModel, body: str) -> np.ndarray:
    """The vertices (n, 3) of a body's skins in the base's frame."""
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    found = []
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        if mesh >= 0 and model.geom_bodyid[geom] == model.body(body).id:
            vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
            found.append(vertices @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
    return np.concatenate(found)


def test_it_is_as_large_as_a_pr2(dressed):
    """668 mm wide and deep, 1330 to 1645 mm tall (Willow Garage's data sheet)."""
    base, head = points(dressed, "base"), points(dressed, "head_tilt_link")
    assert_allclose(np.ptp(base[:, :2], axis=0), 0.668, atol=0.005)
    assert 1.33 < head[:, 2].max() < 1.645


def test_it_can_be_drawn_in_a_headset(dressed):
    meshes = dressed.geom_dataid[dressed.geom_dataid >= 0]
    assert dressed.mesh_facenum[meshes].sum() < 12_000


@pytest.mark.parametrize("hand", ["r", "l"])
def test_closed_fingertips_meet_at_the_tool_frame(hand, dressed):
    data = mujoco.MjData(dressed)
    mujoco.mj_kinematics(dressed, data)
    tool = data.body(f"{hand}_gripper_tool_frame")
    left, right = (
        (points(dressed, f"{hand}_gripper_{finger}_finger_tip_link") - tool.xpos) @ tool.xmat.reshape(3, 3)
        for finger in "lr"
    )
    assert abs(left[:, 1].min()) < 0.001
    assert_allclose(left[:, 1].min(), -right[:, 1].max(), atol=1e-6)
    assert left[:, 0].min() < 0.0 < left[:, 0].max()


def test_it_stands_on_its_wheels(dressed):
    wheels = [
        geom for geom in range(dressed.ngeom) if dressed.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CYLINDER
    ]
    assert len(wheels) == 8
    assert_allclose(dressed.geom_pos[wheels, 2], dressed.geom_size[wheels, 0], atol=0.001)
