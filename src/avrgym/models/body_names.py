"""Names of the two body models, of the sides and of the tracked body parts."""

from typing import Literal, get_args

Sex = Literal["man", "woman"]
SEXES: tuple[Sex, ...] = ("man", "woman")
Side = Literal["left", "right"]
PERSON_ARM_SIDES: tuple[Side, ...] = get_args(Side)
"""The person's arms: ``left`` and ``right``."""

TrackedBodyPart = Literal["head", "left", "right"]
"""A body part with VR tracking: ``head`` (with the trunk), ``left`` arm or ``right`` arm."""
TRACKED_BODY_PARTS: tuple[TrackedBodyPart, ...] = ("head", "left", "right")
TRACKED_BODY_PART_LABELS: dict[TrackedBodyPart, str] = {
    "head": "head",
    "left": "left hand",
    "right": "right hand",
}
