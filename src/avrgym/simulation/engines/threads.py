"""MuJoCo on the host's threads: to the bit the same on any number of them."""

import mujoco
from mujoco.batch import Batch

from avrgym.array_types import IntArray
from avrgym.simulation.engines.batch import ForkSafeBatch
from avrgym.simulation.engines.engine import Arrays, check_host_memory
from avrgym.system.engines import THREADS


class Threads:
    """An ``Engine`` whose worlds are those of its batch."""

    name, device = THREADS, "cpu"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, num_threads: int) -> None:
        """Make the worlds; 0 threads are one per core."""
        check_host_memory(num_worlds, model)
        self.batch: Batch = ForkSafeBatch(model, num_worlds, num_threads, persistent=True)
        self.now = Arrays.of(self.batch)

    def take_over(self, ids: IntArray) -> None:
        """Nothing: they are there."""

    def hand_back(self, ids: IntArray) -> None:
        """Nothing: they are there."""

    def step(self, substeps: int) -> None:
        """See ``Engine``."""
        self.batch.step(nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def check(self) -> None:
        """Nothing: the host's memory grows with what a world needs."""
