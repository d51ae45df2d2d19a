"""h5py carries no types, so all of its names count as ``Any``."""

from typing import Any

def __getattr__(name: str) -> Any: ...
