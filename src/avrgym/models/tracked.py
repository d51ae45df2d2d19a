"""The parts of a person's body that are tracked."""

from typing import Literal

Part = Literal["head", "left", "right"]
"""What of the body follows a tracked pose: head with trunk, or an arm."""
PARTS: tuple[Part, ...] = ("head", "left", "right")
PART_WORDS: dict[Part, str] = {"head": "head", "left": "left hand", "right": "right hand"}
