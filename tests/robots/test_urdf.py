"""Supported URDF: mimicking joints and links without mass are fixed; errors describe all other cases."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from avrgym.models.robot import (
    Arm,
    Robot,
    build_robot_spec,
    compile_robot_model,
    fix_joints,
    make_arm_with_servo_gains,
)
from avrgym.models.urdf import Urdf
from avrgym.robots.registry import ROBOTS
from avrgym.robots.validation import check_robot

INERTIAL = (
    '<inertial><mass value="1"/><inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
LIMIT = '<limit lower="-1" upper="1" effort="5" velocity="1"/>'
BOX = '<box size="0.04 0.04 0.1"/>'
JOINTS = tuple(f"joint_{number}" for number in range(1, 7))


def link(name: str, inertial: str = INERTIAL) -> str:
    return f'<link name="{name}">{inertial}<collision><geometry>{BOX}</geometry></collision></link>'


def joint(name: str, kind: str, parent: str, child: str, axis: str, more: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><origin xyz="0 0 0.15"/><parent link="{parent}"/><child link="{child}"/>'
        f'<axis xyz="{axis}"/>{LIMIT}{more}</joint>'
    )


def description(*, bare: str = "", third: str = "revolute", mimics: str = "joint_9") -> str:
    """An arm of six joints with three fingers that mimic each other; ``bare`` has no inertial."""
    links = ["base", *(f"link_{number}" for number in range(1, 7)), "thumb", "finger", "tip"]
    parts = [link(name, "" if name == bare else INERTIAL) for name in links]
    for number, name in enumerate(JOINTS):
        kind, axis = (third if number == 2 else "revolute"), ("0 0 1", "0 1 0", "1 0 0")[number % 3]
        parts.append(joint(name, kind, links[number], links[number + 1], axis))
    follows = '<mimic joint="joint_7" multiplier="-2" offset="0.01"/>'
    parts += [
        joint("joint_7", "prismatic", "link_6", "thumb", "1 0 0"),
        joint(
            "joint_8", "prismatic", "link_6", "finger", "1 0 0", f'<mimic joint="{mimics}" multiplier="3"/>'
        ),
        joint("joint_9", "revolute", "finger", "tip", "0 1 0", follows),
    ]
    return f"<robot name='r'>{''.join(parts)}</robot>"


def build(text: str) -> mujoco.MjSpec:
    return Urdf(text, Path).build_spec(appearance=False)


def arm_of(text: str) -> Arm:
    return make_arm_with_servo_gains(
        lambda _: build(text), JOINTS, "link_6", np.zeros(6), speed_limit=1.0, effort_limit=5.0
    )


def robot_of(text: str, arm: Arm) -> Robot:
    jaco = ROBOTS["Jaco"]
    grips = {
        name: replace(grip, finger_joint_positions={"joint_7": 0.02}) for name, grip in jaco.grips.items()
    }
    return replace(
        jaco, name="Made", build=lambda _: build(text), base="base", torso="base", fixed_joint_positions={},
        arms={"right": arm, "left": arm}, grips=grips,
    )  # fmt: skip


def test_a_joint_that_mimics_is_where_the_other_one_puts_it() -> None:
    text = description()
    free, held = build(text), build(text)
    model = free.compile()
    data = mujoco.MjData(model)
    ninth = 0.01 - 2 * 0.02
    for name, position in {"joint_7": 0.02, "joint_8": 3 * ninth, "joint_9": ninth}.items():
        data.joint(name).qpos[:] = position
    mujoco.mj_kinematics(model, data)
    fix_joints(held, JOINTS, {"joint_7": 0.02})
    welded = held.compile()
    assert (welded.njnt, welded.neq) == (6, 0)
    there = mujoco.MjData(welded)
    mujoco.mj_kinematics(welded, there)
    for body in ("thumb", "finger", "tip"):
        np.testing.assert_allclose(there.body(body).xpos, data.body(body).xpos, atol=1e-9)
        np.testing.assert_allclose(there.body(body).xmat, data.body(body).xmat, atol=1e-9)


def test_a_robot_whose_gripper_mimics_can_be_used() -> None:
    text = description()
    robot = robot_of(text, arm_of(text))
    check_robot(robot)
    for grip in robot.grips.values():
        assert (
            compile_robot_model(build_robot_spec(robot, robot.arms["right"], grip, appearance=True)).njnt == 6
        )


def test_a_joint_that_mimics_a_moving_one_follows_it() -> None:
    text = description(mimics="joint_2")
    model = compile_robot_model(
        build_robot_spec(robot_of(text, arm_of(text)), arm_of(text), appearance=False)
    )
    data = mujoco.MjData(model)
    data.ctrl[model.actuator("joint_2").id] = 0.2
    mujoco.mj_step(model, data, 500)
    assert data.joint("joint_2").qpos[0] > 0.05
    assert data.joint("joint_8").qpos[0] == pytest.approx(3.0 * data.joint("joint_2").qpos[0], rel=0.05)


def test_a_moving_joint_that_mimics_is_refused() -> None:
    with pytest.raises(ValueError, match="joint 'joint_8' of the arm mimics joint 'joint_2'"):
        fix_joints(build(description(mimics="joint_2")), ["joint_2", "joint_8"], {})


@pytest.mark.parametrize("bare", ["base", "thumb", "finger", "tip"])
def test_links_that_are_held_need_no_mass(bare: str) -> None:
    text = description(bare=bare)
    check_robot(robot_of(text, arm_of(text)))


def test_a_moving_link_without_mass_is_named() -> None:
    text = description()
    for name in ("link_6", "thumb", "finger", "tip"):
        text = text.replace(link(name), link(name, ""))
    message = "link 'link_6' moves but has no mass; add an <inertial>"
    with pytest.raises(ValueError, match=message):
        arm_of(text)
    with pytest.raises(ValueError, match=message):
        check_robot(robot_of(text, arm_of(description())))


def test_a_joint_of_an_arm_may_be_prismatic() -> None:
    text = description(third="prismatic")
    check_robot(robot_of(text, arm_of(text)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="r"/>',
            "file is xacro; allowed: URDF. .*`xacrodoc FILE.xacro",
        ),
        ('<robot><link name="$(find arm)/a"/></robot>', "file is xacro; allowed: URDF"),
        ("/home/me/arm.urdf", "not XML: .*; allowed: the text of a URDF file, not its path"),
        ("<mujoco/>", "the root element of the URDF is <mujoco>; allowed: <robot>"),
        (
            description(third="floating"),
            "joint 'joint_3' has the type 'floating'; allowed: revolute, continuous, prismatic",
        ),
        (description(third="planar"), "joint 'joint_3' has the type 'planar'; allowed: revolute"),
    ],
    ids=["xacro", "find", "path", "mjcf", "floating", "planar"],
)
def test_invalid_urdf_is_rejected_with_a_fix(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build(text)
    with pytest.raises(ValueError, match=message):
        Urdf(text, Path).read_joint_limits(["joint_1"])
