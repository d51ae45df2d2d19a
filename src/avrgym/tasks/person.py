"""Constants that several tasks use: initial poses, limbs, and the limit of comfortable forces."""

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.models.human import JOINTS, RIGHT_ARM_BODIES, SEATED_POSE_RAD
from avrgym.people import distributions
from avrgym.people.distributions import PoseDistribution

TURNED_HEAD_POSE = PoseDistribution(
    rest_angles_rad=SEATED_POSE_RAD,
    max_offset_rad=np.array([np.radians(30.0) if joint.body == "head" else 0.0 for joint in JOINTS.values()]),
)
"""Initial pose: seated, the head turned by up to 30° about each axis (paper, section IV)."""
MAX_ARM_OFFSET_RAD = np.where(distributions.RIGHT_ARM_JOINT_MASK, np.radians(10.0), 0.0)
"""Maximum random offset of each joint of the right arm from the rest pose (20,) (paper, section V)."""

RIGHT_ARM_LIMBS = RIGHT_ARM_BODIES[:2]
"""The limbs in itch scratching and bed bathing: right upper arm and forearm."""
COMFORT_FORCE_LIMIT_N = 10.0
"""Limit of a comfortable contact force at the target (paper, section V, and its code)."""
SKIN_MARGIN_M = 0.008
LATERAL_AXES = np.array([1.0, 1.0, 0.0])
"""Factors (3,) for vectors in a limb's frame that remove the component along the limb."""


def zero_comfortable_forces(force_n: FloatArray) -> FloatArray:
    """Returns the forces (N,), with zero for forces below ``COMFORT_FORCE_LIMIT_N``."""
    return get_namespace(force_n).where(force_n >= COMFORT_FORCE_LIMIT_N, force_n, 0.0)


def move_above_sleeve(places: FloatArray) -> FloatArray:
    """Returns points (..., 3) in the limb's frame, moved outwards from the collision shape. Markers there are visible
    above skin and sleeve.
    """
    outwards = places * constant_like(LATERAL_AXES, places)
    return places + SKIN_MARGIN_M * transforms.normalize(outwards)
