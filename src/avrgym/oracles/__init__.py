"""Scripted controllers that may look at everything: they show that a task can be done."""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from avrgym.oracles.bed_bathing import BedBathingOracle
from avrgym.oracles.drinking import DrinkingOracle
from avrgym.oracles.feeding import FeedingOracle
from avrgym.oracles.scratch_itch import ScratchItchOracle
from avrgym.tasks.episodes import Episodes

Array = NDArray[np.float64]

ORACLES: Mapping[str, Callable[[Episodes], Callable[[Array], Array]]] = {
    "Feeding": FeedingOracle,
    "Drinking": DrinkingOracle,
    "ScratchItch": ScratchItchOracle,
    "BedBathing": BedBathingOracle,
}
"""By task: made when episodes have begun, then called with the observation (N, O) of every control step."""
