"""A zoo of partners: named styles in which people behave, each in many strengths, delays and tempos."""

from avrgym.people.zoo.partners import ZOOS, Partners
from avrgym.people.zoo.styles import STYLES, Style

__all__ = ["STYLES", "ZOOS", "Partners", "Style"]
