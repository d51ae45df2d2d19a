"""Names of the two body models and of the tracked body parts."""

from typing import Literal

Sex = Literal["man", "woman"]
SEXES: tuple[Sex, ...] = ("man", "woman")

Part = Literal["head", "left", "right"]
"""A tracked body part: the head with the trunk, or one arm."""
PARTS: tuple[Part, ...] = ("head", "left", "right")
PART_LABELS: dict[Part, str] = {"head": "head", "left": "left hand", "right": "right hand"}
