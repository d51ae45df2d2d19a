"""Where the robot stands and how its arm begins."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import elementary, kinematics, transforms
from avrgym.models import human
from avrgym.models.furniture import JACO_MOUNT_M, NIGHTSTAND_BODY, NIGHTSTAND_TOP_M
from avrgym.models.human import RECLINED, SEATED, People, Posture
from avrgym.models.robots import Robot, Side
from avrgym.models.scene import TOOL_BODY, BaseRange, SceneConfig, robot_with_tool
from avrgym.models.tools import Tool
from avrgym.simulation import base_search
from avrgym.simulation.base_search import BasePoses
from avrgym.simulation.worlds import Start

Array = NDArray[np.float64]

UNIFORMS = max(kinematics.RESTART_UNIFORMS, base_search.UNIFORMS)
Z = [0.0, 0.0, 1.0]
FURNITURE_EDGE_M: Mapping[Posture, float] = {SEATED: -0.345, RECLINED: -0.47}
"""The x up to which wheelchair and bed reach on the robot's side."""
STANDING_M = (-0.85, -0.4, 0.0)
"""Where a mobile robot stands beside the person, facing their right side (reference)."""
STANDING_RANGE = BaseRange((-0.5, 0.0), (-0.5, 0.5), (-np.radians(30.0), np.radians(30.0)))
BEDSIDE_RANGE = BaseRange((-0.5, 0.0), (-0.5, 0.3), STANDING_RANGE.yaw_rad)
"""Farther up the raised backrest is in the arm's way."""
NIGHTSTAND_RANGE = BaseRange((-0.1, 0.1), (-0.1, 0.1), (0.0, 0.0))


def wheelchair_scene(
    robot: Robot,
    side: Side,
    tool: Tool,
    standing_offset_m: tuple[float, float],
    furniture: Sequence[str] = (),
    movable: Sequence[str] = (),
    chair: str = "wheelchair",
) -> SceneConfig:
    """A person in a wheelchair; the robot is mounted on its right side, or stands beside it.

    ``standing_offset_m`` (x, y) is added to the place of a mobile robot; ``chair`` names the wheelchair.
    """
    arm = robot.arms[side]
    if not robot.mobile:
        around = (chair, "jaco_bracket", *furniture)
        return SceneConfig(around, movable, SEATED, robot, arm, tool, JACO_MOUNT_M, -0.5 * np.pi)
    x, y, z = STANDING_M
    place = (x + standing_offset_m[0], y + standing_offset_m[1], z)
    return SceneConfig((chair, *furniture), movable, SEATED, robot, arm, tool, place, 0.0, STANDING_RANGE)


def bed_scene(robot: Robot, side: Side, tool: Tool) -> SceneConfig:
    """A person in a hospital bed; the robot stands on a nightstand that goes with it, or beside the bed."""
    arm = robot.arms[side]
    if robot.mobile:
        return SceneConfig(("hospital_bed",), (), RECLINED, robot, arm, tool, STANDING_M, 0.0, BEDSIDE_RANGE)
    return SceneConfig(
        ("hospital_bed", NIGHTSTAND_BODY), (NIGHTSTAND_BODY,), RECLINED, robot, arm, tool,
        NIGHTSTAND_TOP_M, -0.5 * np.pi, NIGHTSTAND_RANGE,
    )  # fmt: skip


@cache
def arm_chain(scene: SceneConfig) -> kinematics.Chain:
    """The moving arm of the scene's robot, from the robot's base to the tool."""
    model = robot_with_tool(scene, appearance=False).compile()
    return kinematics.chain_of(model, scene.arm.joints, scene.robot.base, TOOL_BODY)


def mouth(people: People) -> tuple[Array, Array]:
    """Where the mouths (n, 3) and how the heads (n, 4) of seated people are, world frame."""
    pos_w, q_w = human.body_frames(people)
    site = human.layout(people.is_woman, people.torso_height_m).site_pos["mouth"]
    return transforms.compose(pos_w["head"], q_w["head"], site, transforms.IDENTITY_QUATERNION)


def right_arm(people: People, posture: Posture) -> Array:
    """Shoulder, elbow and wrist (n, 3, 3) of the people's right arms, world frame."""
    pos_w, _ = human.body_frames(people, posture)
    return np.stack([pos_w[name] for name in human.RIGHT_ARM], axis=1)


def held(scene: SceneConfig, hand_pos_w: Array, tool_q_w: Array) -> tuple[Array, Array]:
    """The tool's poses, (n, 3) and (n, 4), in hands at positions (n, 3), all turned alike (4,)."""
    pos_w = hand_pos_w - transforms.rotate(tool_q_w, scene.tool.grip_pos)
    return pos_w, np.tile(tool_q_w, (len(pos_w), 1))


def start(
    scene: SceneConfig,
    people: People,
    placed_pos_w: dict[str, Array],
    tool_pos_w: Array,
    tool_q_w: Array,
    goal_pos_w: Array,
    goal_q_w: Array,
    uniforms: Array,
) -> Start:
    """How n worlds begin whose tool starts at positions (n, 3) and rotations (n, 4).

    A base that may be chosen is searched for among ``base_search.CANDIDATES``: one from which the tool also
    reaches the goals, (n, G, 3) and (n, G, 4). ``uniforms`` (n, ``UNIFORMS``) draw the candidates, or drive the
    restarts of the inverse kinematics where the seed pose of a mounted arm does not lead there.
    """
    chain, seed_rad = arm_chain(scene), scene.arm.seed_pose_rad
    if scene.base_range is not None:
        candidates = _clear_of_furniture(
            scene, base_search.sample(scene.base_range, scene.robot_pos_w, scene.robot_yaw_rad, uniforms)
        )
        found = base_search.search(chain, candidates, tool_pos_w, tool_q_w, goal_pos_w, goal_q_w, seed_rad)
        base_q = transforms.from_axis_angle(Z, found.base.yaw_rad)
        return Start(people, found.base.pos_w, base_q, found.angles_rad, placed_pos_w)
    base_pos = np.tile(scene.robot_pos_w, (len(tool_pos_w), 1))
    base_q = np.tile(transforms.from_axis_angle(Z, scene.robot_yaw_rad), (len(tool_pos_w), 1))
    pos, q = transforms.compose(*transforms.invert(base_pos, base_q), tool_pos_w, tool_q_w)
    restarts = uniforms[:, : kinematics.RESTART_UNIFORMS]
    angles = kinematics.solve_with_restarts(chain, pos, q, seed_rad, restarts)
    return Start(people, base_pos, base_q, angles, placed_pos_w)


def _clear_of_furniture(scene: SceneConfig, candidates: BasePoses) -> BasePoses:
    """The candidates, moved away from the person where a corner of the base would stand in the furniture."""
    sine, cosine = elementary.sine_and_cosine(candidates.yaw_rad)
    turned = np.abs(cosine) + np.abs(sine)
    nearest = FURNITURE_EDGE_M[scene.posture] - scene.robot.half_width_m * turned
    pos_w = candidates.pos_w.copy()
    pos_w[..., 0] = np.minimum(pos_w[..., 0], nearest)
    return replace(candidates, pos_w=pos_w)
