"""Collision bits of MuJoCo geoms (``contype``, ``conaffinity``) for people, robots, tools and furniture."""

from dataclasses import dataclass

COLLISION_GROUP = 3
VISUAL_GROUP = 2

_PERSON, _ROBOT, _TOOL, _PARTICLE, _FURNITURE, _HULL = 1, 2, 4, 8, 16, 32


@dataclass(frozen=True)
class CollisionBits:
    """Collision bits of a geom.

    Two geoms collide if ``contype`` of one geom and ``conaffinity`` of the other geom share a bit.
    """

    contype: int
    conaffinity: int


PERSON = CollisionBits(_PERSON, 0)
ROBOT = CollisionBits(_ROBOT, _PERSON)
TOOL = CollisionBits(_TOOL, _PERSON)
HULL = CollisionBits(_HULL, _PERSON)
PARTICLE = CollisionBits(_PARTICLE, _PERSON | _TOOL | _PARTICLE | _FURNITURE)
FURNITURE = CollisionBits(_FURNITURE, _ROBOT | _TOOL)
CLOTH = CollisionBits(0, _PERSON)
NO_COLLISION = CollisionBits(0, 0)
"""Bits of geoms that never collide, but reserve space. People's initial poses avoid this space."""
