"""MuJoCo on threads of the host. Results are bit-identical with any number of threads."""

import mujoco
from mujoco.batch import Batch

from avrgym.array_types import IntArray
from avrgym.simulation.engines.batch import ForkSafeBatch
from avrgym.simulation.engines.engine import Arrays, check_host_memory
from avrgym.system.engines import THREADS


class Threads:
    """An ``Engine`` that steps the worlds of its batch."""

    name, device = THREADS, "cpu"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, num_threads: int) -> None:
        """Create the worlds. 0 threads: one per core."""
        check_host_memory(num_worlds, model)
        self.batch: Batch = ForkSafeBatch(model, num_worlds, num_threads, persistent=True)
        self.now = Arrays.of(self.batch)

    def copy_from_host(self, ids: IntArray) -> None:
        """Does nothing: the worlds are on the host."""

    def copy_to_host(self, ids: IntArray) -> None:
        """Does nothing: the worlds are on the host."""

    def step(self, substeps: int) -> None:
        """See ``Engine``."""
        self.batch.step(nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def check(self) -> None:
        """Does nothing: memory on the host grows as needed."""
