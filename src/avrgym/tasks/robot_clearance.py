"""Distance of the robot's moving arm from person and furniture, for many arm poses."""

from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry import capsules, kinematics, transforms
from avrgym.models import collision_bits
from avrgym.models.scene import TOOL_BODY, SceneConfig, build_robot_with_tool_spec
from avrgym.models.self_collision import find_collision_pairs
from avrgym.models.task_frame import LINK_MIRROR_FACTORS
from avrgym.people.arm_clearance import Boxes


@dataclass(frozen=True, eq=False)
class ArmCapsules:
    """Capsules of arm, hand and tool.

    Attributes:
        link_chains: kinematic chains from the robot's base to each moving body, in joint order.
        link_index: index of each capsule's link (C,).
        axis_ends: ends of each capsule's axis in the link frame (C, 2, 3).
        radius_m: radii of the capsules (C,).
        is_tool: boolean mask (C,) of the tool's capsules.
    """

    link_chains: tuple[kinematics.Chain, ...]
    link_index: IntArray
    axis_ends: FloatArray
    radius_m: FloatArray
    is_tool: BoolArray


@cache
def make_arm_capsules(scene: SceneConfig, chain: kinematics.Chain) -> ArmCapsules:
    """Returns capsules around the collision geoms of the moving arm and of a driving base.

    ``chain`` is the scene's ``placement.make_planning_chain``.
    """
    moving = [capsule for capsule in _robot_capsules(scene) if capsule.link >= 0]
    links = tuple(_part(chain, count) for count in range(1, len(chain.lower_limit) + 1))
    return ArmCapsules(
        links,
        np.array([capsule.link for capsule in moving]),
        np.array([capsule.ends for capsule in moving]),
        np.array([capsule.radius_m for capsule in moving]),
        np.array([capsule.body == TOOL_BODY for capsule in moving]),
    )


@dataclass(frozen=True, eq=False)
class SelfCollisionShape:
    """Capsules of a whole robot, and pairs of capsules that may collide.

    ``capsules`` contains all capsules. Capsules of fixed parts have the ``link_index`` −1; their ends are in the frame
    of the base. ``capsule_pairs`` (P, 2) are indices of capsules.
    """

    capsules: ArmCapsules
    capsule_pairs: IntArray


@cache
def make_self_collision_shape(scene: SceneConfig, chain: kinematics.Chain) -> SelfCollisionShape:
    """Returns the capsules of a scene's robot, and the pairs of capsules that may collide.

    Capsules are larger than the links. Pairs of capsules that overlap at the seed pose are therefore excluded.
    """
    capsules_of = _robot_capsules(scene)
    links = tuple(_part(chain, count) for count in range(1, len(chain.lower_limit) + 1))
    arm = ArmCapsules(
        links,
        np.array([capsule.link for capsule in capsules_of]),
        np.array([capsule.ends for capsule in capsules_of]),
        np.array([capsule.radius_m for capsule in capsules_of]),
        np.zeros(len(capsules_of), bool),
    )
    colliding = find_collision_pairs(scene.robot, scene.arm)
    pairs = [
        (one, other)
        for (one, first), (other, second) in combinations(enumerate(capsules_of), 2)
        if frozenset((first.body, second.body)) in colliding
    ]
    found = SelfCollisionShape(arm, np.array(pairs, dtype=np.intp).reshape(-1, 2))
    travel = len(chain.lower_limit) - len(scene.arm.joints)
    seed = np.concatenate([np.zeros(travel), scene.arm.seed_pose])
    apart = _pair_gaps_m(found, seed[None])[0] > 0.0
    return SelfCollisionShape(arm, found.capsule_pairs[apart])


def compute_min_self_distance_m(
    scene: SceneConfig, chain: kinematics.Chain, joint_positions: FloatArray
) -> FloatArray:
    """Returns the smallest distance (N,) in metres between links that may collide, at joint positions (N, J)."""
    return _pair_gaps_m(make_self_collision_shape(scene, chain), joint_positions).min(axis=-1, initial=np.inf)


def _pair_gaps_m(shape: SelfCollisionShape, joint_positions: FloatArray) -> FloatArray:
    """Returns the distances (N, P) in metres between the capsules of each pair, at joint positions (N, J)."""
    ends = _link_ends(shape.capsules, joint_positions)
    one, other = shape.capsule_pairs.T
    apart = capsules.segment_distance(ends[:, one, 0], ends[:, one, 1], ends[:, other, 0], ends[:, other, 1])
    return apart - shape.capsules.radius_m[one] - shape.capsules.radius_m[other]


def _link_ends(shape: ArmCapsules, joint_positions: FloatArray) -> FloatArray:
    """Returns the ends (N, C, 2, 3) of capsule axes at joint positions (N, J), in the frame of the base."""
    ends = np.tile(shape.axis_ends, (len(joint_positions), 1, 1, 1))
    for number, chain in enumerate(shape.link_chains):
        on_link = np.nonzero(shape.link_index == number)[0]
        pos, q = kinematics.forward_kinematics(chain, joint_positions[:, : number + 1])
        ends[:, on_link] = pos[:, None, None] + transforms.rotate(q[:, None, None], shape.axis_ends[on_link])
    return ends


class _Capsule(NamedTuple):
    """A capsule around a collision geom.

    ``body`` is the name of its body, ``link`` the index of the moving link or −1. ``ends`` (2, 3) are the ends of its
    axis in the frame of link or base.
    """

    body: str
    link: int
    ends: FloatArray
    radius_m: float


def _robot_capsules(scene: SceneConfig) -> list[_Capsule]:
    """Returns capsules around the collision geoms of the robot and its tool."""
    model = build_robot_with_tool_spec(scene, appearance=False).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    base = model.body(scene.robot.base).id
    bodies = [int(model.joint(name).bodyid[0]) for name in scene.arm.joints]
    if scene.robot.drive is not None:
        bodies.insert(0, base)
    sides = LINK_MIRROR_FACTORS if scene.task_frame.is_mirrored else 1.0
    found: list[_Capsule] = []
    for geom in np.nonzero(model.geom_group == collision_bits.COLLISION_GROUP)[0]:
        carrier = _carrier(model, int(model.geom_bodyid[geom]), bodies)
        body = base if carrier is None else bodies[carrier]
        axis, radius_m = _capsule(model.geom_type[geom], model.geom_size[geom])
        centre_w, rotation_w = data.geom_xpos[geom], data.geom_xmat[geom].reshape(3, 3)
        ends_w = centre_w + np.array([-1.0, 1.0])[:, None] * (rotation_w @ axis)
        ends = sides * ((ends_w - data.xpos[body]) @ data.xmat[body].reshape(3, 3))
        name = model.body(model.geom_bodyid[geom]).name
        found.append(_Capsule(name, -1 if carrier is None else carrier, ends, radius_m))
    return found


@cache
def make_fixed_furniture_boxes(scene: SceneConfig) -> Boxes:
    """Returns boxes around the collision geoms of the furniture, in the scene's frame. Movable bodies are excluded."""
    spec = mujoco.MjSpec()
    for add in scene.furniture:
        add(spec, False)
    model, data = (compiled := spec.compile()), mujoco.MjData(compiled)
    mujoco.mj_kinematics(model, data)
    geoms = [
        geom
        for geom in np.nonzero(model.geom_contype == collision_bits.FURNITURE.contype)[0]
        if model.body(model.geom_bodyid[geom]).name not in scene.movable_bodies
    ]
    centre, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    q_w = transforms.from_matrix(data.geom_xmat[geoms].reshape(-1, 3, 3))
    return Boxes(data.geom_xpos[geoms] + transforms.rotate(q_w, centre), q_w, half).transform_to_frame(
        scene.task_frame
    )


class RobotClearance:
    """Computes the distances of the arms in N worlds from person and furniture, at any joint positions."""

    def __init__(
        self, scene: SceneConfig, chain: kinematics.Chain, base_pos_w: FloatArray, base_q_w: FloatArray
    ) -> None:
        """Store the shapes of arm and furniture, and the initial poses of the robots' bases, (N, 3) and (N, 4).

        ``chain`` is the scene's ``placement.make_planning_chain``.
        """
        self._shape, self._boxes = make_arm_capsules(scene, chain), make_fixed_furniture_boxes(scene)
        self._base_pos_w, self._base_q_w = (part[:, None, None, None] for part in (base_pos_w, base_q_w))

    def compute_min_distance_m(
        self, joint_positions: FloatArray, segments_w: FloatArray, radii_m: FloatArray, *, tool: bool
    ) -> FloatArray:
        """Returns the smallest distance (N, M) in metres between the arm and person or furniture. It is negative for an
        overlap.

        Args:
            joint_positions: M arm poses (N, M, J), joints of ``placement.make_planning_chain``.
            segments_w: ends (N, G, 2, 3) of the axes of the person's capsules, world frame.
            radii_m: radii (N, G) of these capsules.
            tool: whether to include the tool. The hand is always included.
        """
        counts = np.nonzero(tool | ~self._shape.is_tool)[0]
        start, end = np.moveaxis(self._ends_w(joint_positions)[:, :, counts, None], -2, 0)
        person = segments_w[:, None, None]
        to_person = capsules.segment_distance(start, end, person[..., 0, :], person[..., 1, :])
        to_person = (to_person - radii_m[:, None, None]).min(axis=-1)
        boxes = self._boxes
        to_boxes = capsules.segment_box_distance(boxes.pos_w, boxes.quat_w, boxes.half_size_m, start, end)
        to_axis = np.minimum(to_person, to_boxes.min(axis=-1))
        return (to_axis - self._shape.radius_m[counts]).min(axis=-1)

    def compute_furniture_distance_m(self, joint_positions: FloatArray) -> FloatArray:
        """Returns the smallest distance (N,) in metres between the arm and furniture, at joint positions (N, J).

        Arm and hand are included, the tool is not.
        """
        counts = np.nonzero(~self._shape.is_tool)[0]
        start, end = np.moveaxis(self._ends_w(joint_positions[:, None])[:, :, counts, None], -2, 0)
        boxes = self._boxes
        to_boxes = capsules.segment_box_distance(boxes.pos_w, boxes.quat_w, boxes.half_size_m, start, end)
        return (to_boxes.min(axis=-1) - self._shape.radius_m[counts]).min(axis=-1)[:, 0]

    def _ends_w(self, joint_positions: FloatArray) -> FloatArray:
        """Returns the ends (N, M, C, 2, 3) of the arm's capsule axes in the world frame."""
        worlds, poses, joints = joint_positions.shape
        ends = _link_ends(self._shape, joint_positions.reshape(-1, joints)).reshape(worlds, poses, -1, 2, 3)
        return self._base_pos_w + transforms.rotate(self._base_q_w, ends)


def _carrier(model: mujoco.MjModel, body: int, bodies: list[int]) -> int | None:
    """Returns the index of the moving body to which ``body`` belongs, or ``None``."""
    while body not in bodies:
        if body == 0:
            return None
        body = int(model.body_parentid[body])
    return bodies.index(body)


def _capsule(kind: int, size: FloatArray) -> tuple[FloatArray, float]:
    """Returns the half axis (3,) and the radius of a capsule around a geom."""
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return np.zeros(3), float(size[0])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        longest = int(np.argmax(size))
        return np.eye(3)[longest] * size[longest], float(np.linalg.norm(np.delete(size, longest)))
    return np.array([0.0, 0.0, size[1]]), float(size[0])


def _part(chain: kinematics.Chain, count: int) -> kinematics.Chain:
    """Returns the chain of the first ``count`` joints. Its tip is the body of the last joint."""
    return replace(
        chain,
        body_pos=chain.body_pos[:count],
        body_quat=chain.body_quat[:count],
        joint_axis=chain.joint_axis[:count],
        tip_pos=np.zeros(3),
        tip_quat=transforms.IDENTITY_QUATERNION,
        lower_limit=chain.lower_limit[:count],
        upper_limit=chain.upper_limit[:count],
        slide_joints=frozenset(joint for joint in chain.slide_joints if joint < count),
    )
