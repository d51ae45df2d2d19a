"""Laws of every robot: packaged robots, and robots of the example package."""

import sys
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from avrgym.geometry import kinematics, transforms
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.cup import CUP
from avrgym.models.human import Person
from avrgym.models.robot import Arm, Robot, UnsuitableRobotError, build_robot_spec, build_robot_spec_with_tool
from avrgym.models.scene import build_scene_spec
from avrgym.models.scratcher import SCRATCHER
from avrgym.models.spoon import SPOON
from avrgym.models.washcloth import WASHCLOTH
from avrgym.robots import registry
from avrgym.robots.registry import ROBOTS
from avrgym.robots.validation import check_robot
from avrgym.tasks.registry import TASKS
from avrgym.tasks.task import Task
from avrgym.vr.scene.scene_export import export_glb
from helpers.browser.glb import GlbFile
from helpers.system.paths import ROOT

sys.path.append(str(ROOT / "examples" / "extension" / "src"))

from avrgym_example.fetch import FETCH

TOOLS = {tool.name: tool for tool in (SPOON, CUP, SCRATCHER, WASHCLOTH)}
EVERY = {robot.name: robot for robot in (*ROBOTS.values(), FETCH)}
GRIPS = [(robot, tool) for robot in EVERY.values() for tool in robot.grips]
DEEPEST_M, PINCHED_M, FARTHEST_M = 0.003, 0.008, 0.003
"""How deep a finger's hull may lie in a tool's, and in the cloth that it pinches; how far off it is at most."""


@pytest.fixture(params=EVERY.values(), ids=list(EVERY))
def robot(request) -> Robot:
    return request.param


def arm_of(robot: Robot) -> Arm:
    return next(iter(robot.arms.values()))


def suits(task: Task, robot: Robot) -> bool:
    try:
        task.make_scene(robot)
    except UnsuitableRobotError:
        return False
    return True


def chain_of(robot: Robot, arm: Arm) -> kinematics.Chain:
    model = build_robot_spec(robot, arm, appearance=False).compile()
    return kinematics.extract_chain(model, arm.joints, robot.base, arm.end_effector)


def test_its_record_is_valid(robot):
    check_robot(robot)


def test_inverse_kinematics_is_the_inverse_of_forward(robot, rng):
    """From 0.3 rad away, poses well inside the ranges are found again."""
    arm = arm_of(robot)
    chain = chain_of(robot, arm)
    middle, half = (
        0.5 * (chain.lower_limit + chain.upper_limit),
        0.5 * (chain.upper_limit - chain.lower_limit),
    )
    angles = middle + 0.8 * half * rng.uniform(-1.0, 1.0, (200, len(arm.joints)))
    pos, q = kinematics.forward_kinematics(chain, angles)
    found = kinematics.inverse_kinematics(
        chain, pos, q, angles + rng.uniform(-0.3, 0.3, angles.shape), iterations=200
    )
    right = (found.position_error_m < 1e-3) & (found.rotation_error_rad < 1e-2)
    assert right.mean() > 0.97
    again_pos, again_q = kinematics.forward_kinematics(chain, found.joint_positions[right])
    assert_allclose(again_pos, pos[right], atol=1e-3)
    turns = transforms.to_matrix(again_q) - transforms.to_matrix(q[right])
    assert np.abs(turns).max() < 1.5e-2


def test_sizes_follow_its_joints(robot):
    joints = len(arm_of(robot).joints)
    for task in (task for task in TASKS.values() if suits(task, robot)):
        with_jaco = task.make_observation_spec(task.make_scene(ROBOTS["Jaco"])).size
        assert len(task.make_scene(robot).arm.joints) == joints
        displacement = 0 if robot.drive is None else 3
        assert (
            task.make_observation_spec(task.make_scene(robot)).size == with_jaco + joints - 7 + displacement
        )
        assert len(task.make_scene(robot).action_names) == joints + (0 if robot.drive is None else 2)


def test_its_jacobian_is_the_derivative_of_its_kinematics(robot, rng):
    """For hinges and slides, and for a base that travels and turns."""
    arm, drives = arm_of(robot), robot.drive is not None
    chain = chain_of(robot, arm)
    start = arm.seed_pose + rng.uniform(-0.05, 0.05, (20, len(arm.joints)))
    found = kinematics.compute_action_jacobian(chain, start, drives=drives)
    for column in range(found.shape[-1]):
        ends = [moved_tip(chain, start, column, sign * 1e-6) for sign in (-1.0, 1.0)]
        speed = (ends[1][0] - ends[0][0]) / 2e-6
        turn = transforms.multiply(ends[1][1], transforms.conjugate(ends[0][1]))
        assert_allclose(found[:, :3, column], speed, atol=1e-7)
        assert_allclose(found[:, 3:, column], transforms.to_rotation_vector(turn) / 2e-6, atol=1e-7)


def moved_tip(chain, start, column, step):
    """Return the tip after one joint, or the base's travel or turn, has moved by ``step``."""
    joints = start.shape[-1]
    if column < joints:
        return kinematics.forward_kinematics(chain, start + step * np.eye(joints)[column])
    tip = kinematics.forward_kinematics(chain, start)
    turn = transforms.from_axis_angle([0.0, 0.0, 1.0], np.asarray(step * (column - joints)))
    return transforms.compose(np.array([step * (joints + 1 - column), 0.0, 0.0]), turn, *tip)


@pytest.mark.parametrize("robot", ROBOTS.values(), ids=list(ROBOTS))
def test_a_joint_follows_its_command_and_stops(robot):
    """At full speed a joint lags 0.15 s or less. Afterwards all are at their targets."""
    arm = arm_of(robot)
    model = build_robot_spec(robot, arm, appearance=False).compile()
    for number, name in enumerate(arm.joints):
        data = mujoco.MjData(model)
        places = [int(model.joint(joint).qposadr[0]) for joint in arm.joints]
        data.qpos[places] = data.act[:] = arm.seed_pose
        for each in range(model.neq):
            follower, leader = (
                model.jnt_qposadr[joint[each]] for joint in (model.eq_obj1id, model.eq_obj2id)
            )
            data.qpos[follower] = model.eq_data[each, 1] * data.qpos[leader]
        data.ctrl[model.actuator(name).id] = speed = arm.speed_limit[number]
        mujoco.mj_step(model, data, 200)
        assert data.act[number] - data.qpos[places[number]] < 0.15 * speed
        data.ctrl[:] = 0.0
        mujoco.mj_step(model, data, 400)
        assert_allclose(data.qpos[places], data.act, atol=2e-3)


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(("robot", "tool"), GRIPS, ids=[f"{robot.name} {tool}" for robot, tool in GRIPS])
def test_its_grip_holds_the_tool_without_overlap(robot, tool):
    model = build_robot_spec_with_tool(robot, arm_of(robot), TOOLS[tool], "tool", appearance=True).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    seen = [geom for geom in range(model.ngeom) if model.geom_group[geom] == VISUAL_GROUP]
    of_tool = [geom for geom in seen if carried_by(model, geom, "tool")]
    fingers = [geom for geom in seen if "finger" in model.body(model.geom_bodyid[geom]).name.lower()]
    fingers = [geom for geom in fingers if carried_by(model, geom, arm_of(robot).end_effector, siblings=True)]
    assert of_tool
    assert fingers
    gaps = np.array(
        [mujoco.mj_geomDistance(model, data, one, other, 0.1, None) for one in fingers for other in of_tool]
    )
    deepest = PINCHED_M if tool == "washcloth" else DEEPEST_M
    assert -deepest < gaps.min() < FARTHEST_M


def carried_by(model: mujoco.MjModel, geom: int, name: str, *, siblings: bool = False) -> bool:
    """Whether a body carries a geom, or, with ``siblings``, the body that carries that one does."""
    root, body = model.body(name).id, int(model.geom_bodyid[geom])
    if siblings:
        root = int(model.body_parentid[root])
    while body not in (0, root):
        body = int(model.body_parentid[body])
    return body == root


def test_visual_geoms_do_not_change_the_dynamics(robot):
    plain, dressed = (
        build_robot_spec(robot, arm_of(robot), appearance=seen).compile() for seen in (False, True)
    )
    for field in ("body_mass", "body_inertia", "body_pos", "body_quat", "jnt_range", "actuator_gainprm"):
        assert_allclose(getattr(plain, field), getattr(dressed, field))


@pytest.mark.slow
@pytest.mark.parametrize("robot", [ROBOTS["Panda"], FETCH], ids=lambda robot: robot.name)
def test_a_browser_is_shown_a_robot_of_a_package(robot):
    """Every moving link has a node with a mesh in the scene that clients draw."""
    scene = TASKS["Feeding"].make_scene(robot)
    model = build_scene_spec(scene, Person(), moving=True, appearance=True).compile()
    drawn = {body for body, node in GlbFile(export_glb(model)).nodes("body").items() if node.get("children")}
    links = {model.body(model.joint(f"robot/{joint}").bodyid[0]).name for joint in scene.arm.joints}
    assert links <= drawn


# What is refused


ARM = FETCH.arms["right"]
SKIPPED_PLUGINS = {
    "a capital letter": replace(FETCH, name="my-robot"),
    "it has no arms": replace(FETCH, arms={}),
    "it has no mounts": replace(FETCH, mounts={}),
    "it has no grips": replace(FETCH, grips={}),
    "unknown mounts 'sofa'; allowed: wheelchair, bed": replace(FETCH, mounts={"sofa": FETCH.mounts["bed"]}),
    "has 5 joints; allowed: 6 or more": replace(FETCH, arms={"right": replace(ARM, joints=ARM.joints[:5])}),
    r"seed_pose of its right arm has the shape \(8,\); allowed: \(7,\)": replace(
        FETCH, arms={"right": replace(ARM, seed_pose=np.zeros(8))}
    ),
    "effort_limit of its right arm is": replace(
        FETCH, arms={"right": replace(ARM, effort_limit=np.zeros(7))}
    ),
    "base: its model has no 'floor'": replace(FETCH, base="floor"),
    "end_effector of its right arm: its model has no 'paw'": replace(
        FETCH, arms={"right": replace(ARM, end_effector="paw")}
    ),
    "fingers of its grips: its model has no 'thumb'": replace(
        FETCH, grips={"spoon": replace(FETCH.grips["spoon"], finger_joint_positions={"thumb": 0.0})}
    ),
    "outside the range of joint .elbow_flex_joint.": replace(
        FETCH, arms={"right": replace(ARM, seed_pose=np.array([0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0]))}
    ),
}


@pytest.mark.parametrize("words", SKIPPED_PLUGINS)
def test_an_incomplete_record_is_rejected(words):
    before = dict(ROBOTS)
    with pytest.raises(ValueError, match=words):
        registry.register_robot(SKIPPED_PLUGINS[words])
    assert before == ROBOTS


def test_a_name_that_is_taken_is_refused():
    with pytest.raises(ValueError, match="a robot with the name Jaco is already registered"):
        registry.register_robot(replace(FETCH, name="Jaco"))


def test_a_robot_does_the_tasks_for_which_it_has_everything():
    spoon_only = replace(FETCH, grips={"spoon": FETCH.grips["spoon"]})
    assert [name for name, task in TASKS.items() if suits(task, spoon_only)] == ["Feeding"]
    with pytest.raises(ValueError, match="Fetch has no grip"):
        TASKS["Drinking"].make_scene(spoon_only)
