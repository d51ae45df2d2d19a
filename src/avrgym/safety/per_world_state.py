"""State of safety layers with one row for each world: cleared at a reset, and copied with an environment."""

from typing import Any, ClassVar

from avrgym.array_types import IntArray


class PerWorldState:
    """Base class of safety layers. ``STATE`` contains the names of their arrays (N, …) that change from step to
    step."""

    STATE: ClassVar[tuple[str, ...]]

    def snapshot(self) -> dict[str, Any]:
        """Returns the whole state on which the next steps depend."""
        return {name: getattr(self, name).copy() for name in self.STATE}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restores a state from ``snapshot``."""
        for name in self.STATE:
            setattr(self, name, snapshot[name].copy())

    def _clear(self, ids: IntArray) -> None:
        """Set the rows of worlds ``ids`` (n,) to zero, in new arrays."""
        for name in self.STATE:
            array = getattr(self, name).copy()
            array[ids] = 0
            setattr(self, name, array)
