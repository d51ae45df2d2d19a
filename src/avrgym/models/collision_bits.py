"""Which kinds of things touch each other, as MuJoCo's contact bits, in one place."""

from dataclasses import dataclass

COLLISION_GROUP = 3
VISUAL_GROUP = 2

_PERSON, _ROBOT, _TOOL, _PARTICLE, _FURNITURE, _HULL = 1, 2, 4, 8, 16, 32


@dataclass(frozen=True)
class CollisionBits:
    """Two geoms touch when one's ``contype`` meets the other's ``conaffinity``."""

    contype: int
    conaffinity: int


PERSON = CollisionBits(_PERSON, 0)
ROBOT = CollisionBits(_ROBOT, _PERSON)
TOOL = CollisionBits(_TOOL, _PERSON)
HULL = CollisionBits(_HULL, _PERSON)
PARTICLE = CollisionBits(_PARTICLE, _PERSON | _TOOL | _PARTICLE | _FURNITURE)
FURNITURE = CollisionBits(_FURNITURE, _ROBOT | _TOOL)
NO_COLLISION = CollisionBits(0, 0)
"""Touches nothing: what keeps people out of the place of something else."""
