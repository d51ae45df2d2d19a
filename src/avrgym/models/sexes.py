"""The two bodies that people have."""

from typing import Literal

Sex = Literal["man", "woman"]
SEXES: tuple[Sex, ...] = ("man", "woman")
