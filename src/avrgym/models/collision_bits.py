"""Collision bits: which kinds of geoms collide."""

from dataclasses import dataclass

COLLISION_GROUP = 3
VISUAL_GROUP = 2

_PERSON, _ROBOT, _TOOL, _PARTICLE, _FURNITURE, _HULL = 1, 2, 4, 8, 16, 32


@dataclass(frozen=True)
class CollisionBits:
    """Two geoms collide if the ``contype`` of one geom shares a bit with the ``conaffinity`` of the other geom."""

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
"""Geoms with these bits collide with nothing. They mark space that people's initial poses must avoid."""
