"""Ray carries types only in part, and is not installed everywhere, so all of its names count as ``Any``."""

from typing import Any

def __getattr__(name: str) -> Any: ...
