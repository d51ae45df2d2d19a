"""Which kinds of things touch each other, as MuJoCo's contact bits, in one place."""

from dataclasses import dataclass

COLLISION_GROUP = 3
VISUAL_GROUP = 2

_PERSON, _ROBOT, _TOOL, _PARTICLE, _FURNITURE, _HULL = 1, 2, 4, 8, 16, 32


@dataclass(frozen=True)
class ContactBits:
    """Two geoms touch when one's ``contype`` meets the other's ``conaffinity``."""

    contype: int
    conaffinity: int


PERSON = ContactBits(_PERSON, 0)
ROBOT = ContactBits(_ROBOT, _PERSON)
TOOL = ContactBits(_TOOL, _PERSON)
HULL = ContactBits(_HULL, _PERSON)
PARTICLE = ContactBits(_PARTICLE, _PERSON | _TOOL | _PARTICLE | _FURNITURE)
FURNITURE = ContactBits(_FURNITURE, _ROBOT | _TOOL)
ROOM = ContactBits(0, 0)
"""Touches nothing: what keeps people out of the place of something else."""
