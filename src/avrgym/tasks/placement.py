"""Placement of the robot's base and the initial pose of its arm."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import elementary, kinematics, transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models import human
from avrgym.models.body_names import Side
from avrgym.models.furniture import add_hospital_bed, add_wheelchair
from avrgym.models.human import RECLINED_POSTURE, SEATED_POSTURE, People, Posture
from avrgym.models.robot import FurnitureBuilder, Mount, Robot, select_arm_and_mount
from avrgym.models.scene import SceneConfig, build_robot_with_tool_spec
from avrgym.models.task_frame import mirror_chain
from avrgym.models.tools import TOOL_BODY as TOOL_BODY
from avrgym.models.tools import Tool
from avrgym.simulation import base_search
from avrgym.simulation.base_search import BasePoses
from avrgym.simulation.worlds import InitialState
from avrgym.tasks.path_cost import CollisionPathCost, GoalPathCost

NUM_RANDOM_NUMBERS = base_search.NUM_RANDOM_NUMBERS
"""Number of uniform random numbers for the base search.

With a fixed base, the restarts of the inverse kinematics use these numbers.
"""
X_AXIS, Z_AXIS = [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]
_WHEELCHAIR_EDGE_M, _BED_EDGE_M = -0.345, -0.47


def compute_furniture_edge_x_m(posture: Posture) -> float:
    """Returns the x coordinate of the edge of wheelchair or bed, on the person's right."""
    return _WHEELCHAIR_EDGE_M if posture.is_seated else _BED_EDGE_M


def make_wheelchair_scene(
    robot: Robot,
    side: Side,
    tool: Tool,
    standing_offset_m: tuple[float, float],
    furniture: Sequence[FurnitureBuilder] = (),
    movable_bodies: Sequence[str] = (),
    chair: FurnitureBuilder = add_wheelchair,
    *,
    on_left: bool = False,
) -> SceneConfig:
    """Returns the scene of a person in a wheelchair and a robot.

    ``standing_offset_m`` (x, y) is added to the position of a robot on the floor. ``on_left``: the robot's position is
    mirrored to the person's left. ``side`` is the side of the robot's arm in both cases.

    Raises:
        UnsuitableRobotError: if the robot has no suitable arm, mount or grip.
    """
    arm, mount = select_arm_and_mount(robot, "wheelchair", side, tool)
    if mount.is_on_floor:
        x, y, z = mount.pos_w
        mount = replace(mount, pos_w=(x + standing_offset_m[0], y + standing_offset_m[1], z))
    if on_left:
        mount = mount.mirror()
    around, placed = (chair, *_carrier(mount), *furniture), (*_carried(mount), *movable_bodies)
    return SceneConfig(around, placed, SEATED_POSTURE, robot, arm, tool, mount)


def make_bed_scene(robot: Robot, side: Side, tool: Tool) -> SceneConfig:
    """Returns the scene of a person in a hospital bed and a robot.

    Raises:
        UnsuitableRobotError: if the robot has no suitable arm, mount or grip.
    """
    arm, mount = select_arm_and_mount(robot, "bed", side, tool)
    around = (add_hospital_bed, *_carrier(mount))
    return SceneConfig(around, _carried(mount), RECLINED_POSTURE, robot, arm, tool, mount)


def _carrier(mount: Mount) -> tuple[FurnitureBuilder, ...]:
    return () if mount.carrier_builder is None else (mount.carrier_builder,)


def _carried(mount: Mount) -> tuple[str, ...]:
    return () if mount.carrier_body is None else (mount.carrier_body,)


@cache
def make_arm_chain(scene: SceneConfig) -> kinematics.Chain:
    """Returns the kinematic chain of the moving arm, from the robot's base to the tool."""
    model = build_robot_with_tool_spec(scene, appearance=False).compile()
    chain = kinematics.extract_chain(model, scene.arm.joints, scene.robot.base, TOOL_BODY)
    return mirror_chain(chain, scene.tool.mirror_axis) if scene.task_frame.is_mirrored else chain


MAX_DRIVE_TRAVEL_M = 0.8
"""Maximum distance that a planned motion drives a robot forwards or backwards from its start."""


@cache
def make_planning_chain(scene: SceneConfig) -> kinematics.Chain:
    """Returns the kinematic chain for motion planning: ``make_arm_chain``. For a driving base, a slide precedes it.

    Plans treat the drive as a slide and do not rotate the base. Lift, telescoping arm, wrist and drive together give
    the tool six degrees of freedom.
    """
    chain = make_arm_chain(scene)
    return chain if scene.robot.drive is None else kinematics.prepend_slide(chain, MAX_DRIVE_TRAVEL_M)


def compute_mouth_poses(people: People) -> tuple[FloatArray, FloatArray]:
    """Returns mouth positions (n, 3) and head rotations (n, 4) of seated people; world frame."""
    pos_w, q_w = human.compute_body_frames(people, bodies=("head",))
    site = human.compute_body_layout(people.is_woman, people.torso_height_m).site_pos["mouth"]
    return transforms.compose(pos_w["head"], q_w["head"], site, transforms.IDENTITY_QUATERNION)


def compute_right_arm_joint_pos_w(people: People, posture: Posture) -> FloatArray:
    """Returns shoulder, elbow and wrist positions (n, 3, 3) of the right arm; world frame."""
    pos_w, _ = human.compute_body_frames(people, posture, human.RIGHT_ARM_BODIES)
    return get_namespace(people.torso_height_m).stack(
        [pos_w[name] for name in human.RIGHT_ARM_BODIES], axis=1
    )


def compute_tool_pose_in_hand(
    scene: SceneConfig, hand_pos_w: FloatArray, tool_q_w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Returns tool positions (n, 3) and rotations (n, 4) for hand positions (n, 3) and one tool rotation (4,)."""
    pos_w = hand_pos_w - constant_like(transforms.rotate(tool_q_w, scene.tool.grip_pos), hand_pos_w)
    return pos_w, get_namespace(pos_w).tile(constant_like(tool_q_w, pos_w), (len(pos_w), 1))


def find_initial_state(
    scene: SceneConfig,
    people: People,
    placed_pos_w: dict[str, FloatArray],
    tool_pos_w: FloatArray,
    tool_q_w: FloatArray,
    goal_pos_w: FloatArray,
    goal_q_w: FloatArray,
    uniforms: FloatArray,
    *,
    along_goals: bool = False,
) -> InitialState:
    """Returns initial states of n worlds with the tool poses (n, 3) and (n, 4).

    With a movable base, ``base_search`` selects the best of ``base_search.NUM_CANDIDATES`` base poses. From this pose
    the tool should also reach the goals, (n, G, 3) and (n, G, 4). ``uniforms`` (n, ``NUM_RANDOM_NUMBERS``) determine
    the candidates. With a fixed base they determine the restarts of the inverse kinematics. A driving base is shifted
    by the first joint of ``make_planning_chain``.

    With ``along_goals``, the tool will move from goal to goal. ``rehearsal`` computes the cost of this motion for
    several initial states. The state with the lowest cost is selected. With self-collision, the cost of the paths from
    the start to each goal is used instead.
    """
    chain, mount, drives = make_planning_chain(scene), scene.mount, scene.robot.drive is not None
    seed_pose = np.concatenate([np.zeros(int(drives)), scene.arm.seed_pose])
    path_cost = None
    if along_goals or scene.self_collision:
        rehearsal = GoalPathCost if along_goals else CollisionPathCost
        path_cost = rehearsal(scene, chain, people, tool_pos_w, tool_q_w, goal_pos_w, goal_q_w)
    if mount.base_range is None:
        base_pos = np.tile(mount.pos_w, (len(tool_pos_w), 1))
        base_q = np.tile(transforms.from_axis_angle(Z_AXIS, mount.yaw_rad), (len(tool_pos_w), 1))
        pos, q = transforms.compose(*transforms.invert(base_pos, base_q), tool_pos_w, tool_q_w)
        restarts = uniforms[:, : kinematics.count_restart_random_numbers(len(seed_pose))]
        positions = kinematics.inverse_kinematics_with_restarts(chain, pos, q, seed_pose, restarts)
        if path_cost is not None:
            positions = path_cost.find_best_posture(base_pos, mount.yaw_rad, positions, uniforms)
    else:
        candidates = _clear_of_furniture(
            scene, base_search.sample_base_poses(mount.base_range, mount.pos_w, mount.yaw_rad, uniforms)
        )
        found = base_search.search_base_pose(
            chain, candidates, tool_pos_w, tool_q_w, goal_pos_w, goal_q_w, seed_pose, path_cost
        )
        base_pos, base_q = (
            found.base_poses.pos_w,
            transforms.from_axis_angle(Z_AXIS, found.base_poses.yaw_rad),
        )
        positions = found.joint_positions
    tool_error_m = None
    if scene.checks_reach:
        pos, _ = transforms.compose(*transforms.invert(base_pos, base_q), tool_pos_w, tool_q_w)
        tool_error_m = transforms.norm(kinematics.forward_kinematics(chain, positions)[0] - pos)
    if drives:
        base_pos = base_pos + transforms.rotate(base_q, X_AXIS) * positions[:, :1]
        positions = positions[:, 1:]
    placed = placed_pos_w | dict.fromkeys(_carried(mount), base_pos)
    return InitialState(people, base_pos, base_q, positions, placed, tool_error_m)


def _clear_of_furniture(scene: SceneConfig, candidates: BasePoses) -> BasePoses:
    """Returns the candidates. Bases that would overlap the furniture are moved away from the person."""
    sine, cosine = elementary.sine_and_cosine(candidates.yaw_rad)
    turned = np.abs(cosine) + np.abs(sine)
    nearest = compute_furniture_edge_x_m(scene.posture) - scene.robot.base_half_width_m * turned
    pos_w = candidates.pos_w.copy()
    if scene.mount.pos_w[0] < 0.0:
        pos_w[..., 0] = np.minimum(pos_w[..., 0], nearest)
    else:
        pos_w[..., 0] = np.maximum(pos_w[..., 0], -nearest)
    return replace(candidates, pos_w=pos_w)
