"""Names of the two body models and of the tracked body parts."""

from typing import Literal

Sex = Literal["man", "woman"]
SEXES: tuple[Sex, ...] = ("man", "woman")

BodyPart = Literal["head", "left", "right"]
"""A body part with VR tracking: ``head`` (with the trunk), ``left`` arm or ``right`` arm."""
BODY_PARTS: tuple[BodyPart, ...] = ("head", "left", "right")
BODY_PART_LABELS: dict[BodyPart, str] = {"head": "head", "left": "left hand", "right": "right hand"}
