"""MuJoCo on threads of the host. Results are bit-identical with any number of threads."""

import mujoco
import numpy as np
from mujoco.batch import Batch

from avrgym.array_types import FloatArray, IntArray
from avrgym.simulation.engines.batch import ForkSafeBatch
from avrgym.simulation.engines.engine import WorldArrays, check_host_memory
from avrgym.system.engine_names import THREADS


class ThreadsEngine:
    """An ``Engine`` that steps its worlds on threads of the host."""

    name, device = THREADS, "cpu"

    def __init__(self, model: mujoco.MjModel, num_worlds: int, num_threads: int) -> None:
        """Create ``num_worlds`` worlds of a model. With ``num_threads`` 0, there is one thread per core."""
        check_host_memory(num_worlds, model)
        self.batch: Batch = ForkSafeBatch(model, num_worlds, num_threads, persistent=True)
        self.world_arrays = WorldArrays.from_batch(self.batch)

    def copy_from_host(self, ids: IntArray) -> None:
        """Does nothing: the worlds are on the host."""

    def copy_to_host(self, ids: IntArray) -> None:
        """Does nothing: the worlds are on the host."""

    def step(self, substeps: int) -> None:
        """Advance all worlds by physics steps, see ``Engine.step``."""
        self.batch.step(nstep=substeps, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def step_with_controls(self, columns: IntArray, values: FloatArray) -> None:
        """Advance all worlds by K physics steps, see ``Engine.step_with_controls``."""
        if len(values) == 1:
            self.world_arrays.ctrl[:, columns] = values[0]
            self.step(1)
            return
        controls = np.repeat(self.world_arrays.ctrl[:, None], len(values), axis=1)
        controls[..., columns] = values.transpose(1, 0, 2)
        self.batch.rollout(len(values), controls, record=())
        self.batch.forward(stage=mujoco.mjtStage.mjSTAGE_VEL)

    def check_overflow(self) -> None:
        """Does nothing: on the host, MuJoCo's memory for contacts grows as needed."""
