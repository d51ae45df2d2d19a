"""The interface of physics engines, and the available engines."""

from dataclasses import dataclass, fields
from typing import Any, Protocol

import mujoco
from mujoco.batch import Batch

from avrgym.array_types import IntArray
from avrgym.models.drive import DRIVE_JOINTS
from avrgym.models.robot import ROBOT_NAME_PREFIX
from avrgym.system.engine_names import ENGINE_CHOICES, THREADS, WARP
from avrgym.system.memory import get_available_memory_bytes


@dataclass(frozen=True)
class WorldArrays:
    """Arrays of the current state of N worlds, with MuJoCo's names. The first axis is the world.

    The arrays are NumPy arrays or tensors on a device.

    Callers may write the first five arrays between steps. Each step overwrites all other arrays.
    """

    qpos: Any
    qvel: Any
    act: Any
    ctrl: Any
    qfrc_applied: Any
    xpos: Any
    xquat: Any
    site_xpos: Any
    sensordata: Any
    geom_xpos: Any
    geom_xmat: Any

    @classmethod
    def from_batch(cls, batch: Batch) -> "WorldArrays":
        """Returns the current state arrays of a batch, without copies."""
        return cls(**{name: batch.bind(name) for name in WORLD_ARRAY_NAMES})


WORLD_ARRAY_NAMES = tuple(each.name for each in fields(WorldArrays))
WRITABLE_ARRAY_NAMES = WORLD_ARRAY_NAMES[:5]
"""Names of the arrays that callers may write between steps."""


class Engine(Protocol):
    """Interface of a physics engine, which steps N worlds of one model.

    Attributes:
        name: the engine's name in ``--engine``, without the device.
        device: name of the device that computes physics, such as ``cpu``.
        batch: the worlds on the host, with the model fields that differ between worlds. The host computes initial
            states.
        world_arrays: arrays of the current state: the arrays of ``batch``, copies on the host, or tensors on the
            engine's device.
    """

    name: str
    device: str
    batch: Batch
    world_arrays: WorldArrays

    def copy_from_host(self, ids: IntArray) -> None:
        """Copy models and states of worlds ``ids`` (n,) from ``batch``. The next step starts from these states."""
        ...

    def copy_to_host(self, ids: IntArray) -> None:
        """Copy the current states of worlds ``ids`` (n,) to ``batch``."""
        ...

    def step(self, substeps: int) -> None:
        """Advance all worlds by physics steps. Forces are from the last step, positions and velocities from its end.

        Raises:
            RuntimeError: if the contacts or constraints of a world exceeded the engine's memory. If ``world_arrays``
                contains tensors, nothing is checked, because a check would wait for the device.
        """
        ...

    def step_with_controls(self, columns: Any, values: Any) -> None:
        """Advance all worlds by K physics steps, see ``step``.

        Before step k, the ``columns`` (C,) of ``ctrl`` are set to ``values[k]``. ``values`` are (K, N, C).
        """
        ...

    def check_overflow(self) -> None:
        """Check all steps since the last check for overflow.

        Raises:
            RuntimeError: if the contacts or constraints of a world exceeded the engine's memory.
        """
        ...


def make_engine(
    engine: str, model: mujoco.MjModel, num_worlds: int, num_threads: int, *, on_device: bool = False
) -> Engine:
    """Returns the engine with this name.

    Args:
        engine: one of ``ENGINE_CHOICES``.
        model: the model of all worlds.
        num_worlds: number N of worlds.
        num_threads: number of threads on the host; 0 means one per core.
        on_device: whether ``world_arrays`` contains PyTorch tensors on the engine's device, in single precision. A step
            then copies nothing.

    Raises:
        ValueError: for an unknown engine or device, the engine ``threads`` with ``on_device``, or more worlds than
            memory allows. Also for scenes with cloth or a driving robot if the engine is ``warp``.
        RuntimeError: if a package that the engine needs is not installed.
    """
    check_engine_name(engine)
    name, _, device = engine.partition(":")
    if name == THREADS:
        if on_device:
            raise ValueError(
                f"engine {engine!r} has no device; allowed: on_device=False, or engine warp or warp:DEVICE"
            )
        from avrgym.simulation.engines.threads import ThreadsEngine

        return ThreadsEngine(model, num_worlds, num_threads)
    if model.nflex:
        raise ValueError(f"engine {name!r} does not simulate cloth; allowed: {THREADS}")
    if ROBOT_NAME_PREFIX + DRIVE_JOINTS[0] in [model.joint(joint).name for joint in range(model.njnt)]:
        raise ValueError(f"engine {name!r} does not simulate robots that drive; allowed: {THREADS}")
    from avrgym.simulation.engines.warp import WarpEngine

    return WarpEngine(model, num_worlds, num_threads, device, on_device=on_device)


def check_engine_name(engine: str) -> None:
    """Raises ``ValueError`` for an unknown engine name. The message lists the allowed names."""
    name, colon, device = engine.partition(":")
    if engine != THREADS and (name != WARP or bool(colon) != bool(device)):
        raise ValueError(f"unknown engine {engine!r}; allowed: {ENGINE_CHOICES}")


def check_engine_available(engine: str) -> None:
    """Check that an engine can run on this computer.

    Raises:
        ValueError: for an unknown engine or device.
        RuntimeError: if a package that the engine needs is not installed.
    """
    check_engine_name(engine)
    if engine != THREADS:
        from avrgym.simulation.engines.warp import find_device

        find_device(engine.partition(":")[2])


def check_memory(num_worlds: int, bytes_per_world: int, free_bytes: int | None, where: str) -> None:
    """Raises ``ValueError`` for more worlds than memory allows. The message contains the allowed number."""
    if free_bytes is not None and num_worlds * bytes_per_world > free_bytes:
        raise ValueError(
            f"{num_worlds} worlds need {num_worlds * bytes_per_world / 2**30:.1f} GiB of memory on {where}; "
            f"allowed: up to {free_bytes // bytes_per_world} worlds"
        )


def check_host_memory(num_worlds: int, model: mujoco.MjModel) -> None:
    """Raises ``ValueError`` for more worlds than the host's memory allows; see ``check_memory``."""
    check_memory(num_worlds, int(mujoco.MjData(model).nbuffer), get_available_memory_bytes(), "this computer")
