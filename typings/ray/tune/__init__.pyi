"""As all of Ray, its names count as ``Any``."""

from typing import Any

def __getattr__(name: str) -> Any: ...
