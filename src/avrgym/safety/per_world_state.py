"""Base class of safety layers. The arrays of their state have one row for each world."""

from typing import Any, ClassVar

from avrgym.array_types import IntArray


class PerWorldState:
    """Base class of safety layers. ``STATE_FIELDS``: names of the arrays (N, …) that change during episodes."""

    STATE_FIELDS: ClassVar[tuple[str, ...]]

    def snapshot(self) -> dict[str, Any]:
        """Returns the arrays ``STATE_FIELDS`` by name: all data on which the next steps depend."""
        return {name: getattr(self, name).copy() for name in self.STATE_FIELDS}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restores the state of the layer from the result of ``snapshot``."""
        for name in self.STATE_FIELDS:
            setattr(self, name, snapshot[name].copy())

    def _clear(self, ids: IntArray) -> None:
        """Set the rows of worlds ``ids`` (n,) to zero, in new arrays."""
        for name in self.STATE_FIELDS:
            array = getattr(self, name).copy()
            array[ids] = 0
            setattr(self, name, array)
