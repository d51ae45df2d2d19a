"""Collisions of a robot with itself: links of its arm, other arm, torso and base."""

from functools import cache
from itertools import combinations

import mujoco
import numpy as np

from avrgym.models import collision_bits
from avrgym.models.robot import Arm, Robot, build_robot_spec
from avrgym.system import random_streams

NUM_POSE_SAMPLES = 1000
"""Number of sampled poses of the arm in the search for links that can collide."""
MIN_PERMANENT_CONTACT_FRACTION = 0.9
"""Share of sampled poses. A pair of bodies that touches in more poses has overlapping shapes; its collisions are
disabled.
"""


def add_self_collision(spec: mujoco.MjSpec, robot: Robot, arm: Arm, prefix: str) -> None:
    """Enable collisions between the links of a robot in a scene, for the pairs in ``find_collision_pairs``.

    Args:
        spec: model of a scene with the robot, which is changed.
        robot: robot of this scene.
        arm: moving arm of this robot.
        prefix: prefix of the robot's names in the scene.
    """
    bits, colliding = collision_bits.ROBOT, find_collision_pairs(robot, arm)
    for geom in spec.geoms:
        if geom.parent.name.startswith(prefix) and geom.contype == bits.contype:
            geom.conaffinity |= bits.contype
    bodies = [body.name for body in build_robot_spec(robot, arm, appearance=False).bodies[1:]]
    for first, second in combinations(bodies, 2):
        if frozenset((first, second)) not in colliding:
            spec.add_exclude(bodyname1=prefix + first, bodyname2=prefix + second)


@cache
def find_collision_pairs(robot: Robot, arm: Arm) -> frozenset[frozenset[str]]:
    """Returns the pairs of bodies of a robot that may collide, by name.

    These pairs touch in sampled poses of the arm. Three kinds of pairs are excluded:

    - pairs with at most one link between them, because their capsules overlap, but the real links do not
    - pairs that touch at the seed pose
    - pairs that touch in most poses, see ``MIN_PERMANENT_CONTACT_FRACTION``
    """
    spec = build_robot_spec(robot, arm, appearance=False)
    for geom in spec.geoms:
        if geom.group != collision_bits.VISUAL_GROUP:
            geom.contype, geom.conaffinity = 1, 1
    model = spec.compile()
    data = mujoco.MjData(model)
    places = [model.joint(name).qposadr[0] for name in arm.joints]
    ranges = np.array([model.joint(name).range for name in arm.joints])
    poses = random_streams.make_arm_pose_rng().uniform(
        ranges[:, 0], ranges[:, 1], (NUM_POSE_SAMPLES, len(places))
    )
    at_seed, *touching = (_touching(model, data, places, pose) for pose in (arm.seed_pose, *poses))
    pairs, counts = np.unique(
        [sorted(pair) for each in touching for pair in each], axis=0, return_counts=True
    )
    found = {frozenset(map(str, pair)): count for pair, count in zip(pairs, counts, strict=True)}
    return frozenset(
        pair
        for pair, count in found.items()
        if count < MIN_PERMANENT_CONTACT_FRACTION * NUM_POSE_SAMPLES
        and pair not in at_seed
        and not _are_near(model, pair)
    )


def _are_near(model: mujoco.MjModel, pair: frozenset[str]) -> bool:
    """Returns whether at most two joints are between two bodies."""
    one, other = (int(model.body_weldid[model.body(name).id]) for name in pair)
    return other in _ancestors(model, one) or one in _ancestors(model, other)


def _ancestors(model: mujoco.MjModel, body: int) -> list[int]:
    """Returns a body, its parent and its grandparent in the kinematic tree."""
    found = [body]
    for _ in range(2):
        found.append(int(model.body_weldid[model.body_parentid[found[-1]]]))
    return found


def _touching(
    model: mujoco.MjModel, data: mujoco.MjData, places: list[int], pose: np.ndarray
) -> set[frozenset[str]]:
    """Returns the pairs of bodies in contact at a pose of the arm. Pairs of a body and its parent are excluded."""
    data.qpos[places] = pose
    mujoco.mj_kinematics(model, data)
    mujoco.mj_collision(model, data)
    bodies = model.geom_bodyid[data.contact.geom]
    return {frozenset(model.body(body).name for body in pair) for pair in bodies.tolist()}
