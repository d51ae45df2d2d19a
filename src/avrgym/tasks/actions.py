"""Checks actions (shape and finite numbers) before they are executed."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import get_namespace, to_device_of


def validate_actions(
    actions: ArrayLike, shape: tuple[int, ...], ignored: BoolArray | None = None
) -> FloatArray:
    """Returns actions as an array in double precision. Actions of worlds in the mask ``ignored`` (N,) are set to zero.

    Raises:
        ValueError: for a wrong shape, or numbers that are not finite.
    """
    try:
        found = np.array(actions, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"actions are of type {type(actions).__name__}; {_allowed_actions(shape)}") from None
    if found.shape != shape:
        raise ValueError(f"actions have the shape {found.shape}; {_allowed_actions(shape)}")
    if ignored is not None:
        found[ignored] = 0.0
    for place in np.argwhere(~np.isfinite(found))[:1].tolist():
        raise ValueError(f"actions{place} is {found[tuple(place)]}; {_allowed_actions(shape)}")
    return found


def _allowed_actions(shape: tuple[int, ...]) -> str:
    return f"allowed: finite numbers of shape {shape}, -1 to 1 (values outside are clipped)"


class DeviceActionValidator:
    """Checks actions on the engine's device, without copies to the host.

    Numbers that are not finite are reported later, by ``raise_if_invalid``.
    """

    def __init__(self, num_worlds: int, action_size: int, example_array: Any) -> None:
        """Prepare checks of actions (N, A) with the device and data type of the array ``example_array``."""
        self._shape, self._exemplar = (num_worlds, action_size), example_array
        self._invalid: Any = to_device_of(np.zeros(num_worlds, dtype=bool), example_array)

    def validate_actions(self, action: Any) -> Any:
        """Returns the actions. Numbers that are not finite are replaced by zero.

        Raises:
            ValueError: for a wrong shape, type or device.
        """
        there = self._exemplar
        for part, wanted in {"shape": self._shape, "dtype": there.dtype, "device": there.device}.items():
            found = getattr(action, part, None)
            if found != wanted:
                raise ValueError(
                    f"actions have the {part} {found}; allowed: tensors of shape {self._shape}, {there.dtype} on "
                    f"{there.device}"
                )
        xp = get_namespace(action)
        finite = xp.isfinite(action)
        self._invalid = self._invalid | ~xp.all(finite, axis=-1)
        return xp.where(finite, action, 0.0)

    def raise_if_invalid(self) -> None:
        """Raises ``ValueError`` if any action since the last call was not finite."""
        count = int(self._invalid.sum())
        if count:
            self._invalid = self._invalid & False
            raise ValueError(
                f"actions in {count} worlds contain NaN or infinity; {_allowed_actions(self._shape[1:])}"
            )
