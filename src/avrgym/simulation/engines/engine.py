"""Where physics runs: what an engine is, and which there are."""

from dataclasses import dataclass, fields
from typing import Any, Protocol

import mujoco
from mujoco.batch import Batch

from avrgym.array_types import IntArray
from avrgym.system.engines import ENGINES, THREADS, WARP
from avrgym.system.memory import available_bytes


@dataclass(frozen=True)
class Arrays:
    """Live arrays of N worlds, named as MuJoCo names them, world axis first; NumPy's, or tensors on a device.

    The first five may be written between steps; the others are what a step leaves.
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
    def of(cls, batch: Batch) -> "Arrays":
        """Those of a batch."""
        return cls(**{name: batch.bind(name) for name in NAMES})


NAMES = tuple(each.name for each in fields(Arrays))
WRITTEN = NAMES[:5]


class Engine(Protocol):
    """Steps N worlds of one model.

    Attributes:
        name: as it stands in ``--engine``, without its device.
        device: what computes.
        batch: the worlds on the host, where episodes begin: with what differs from one to the other in the model.
        now: the worlds as they are: arrays of ``batch`` itself, copies on the host, or tensors where physics runs.
    """

    name: str
    device: str
    batch: Batch
    now: Arrays

    def take_over(self, ids: IntArray) -> None:
        """Go on with worlds ``ids`` (n,) as they are in ``batch`` now, models and states."""
        ...

    def hand_back(self, ids: IntArray) -> None:
        """Have worlds ``ids`` (n,) in ``batch`` as they are now."""
        ...

    def step(self, substeps: int) -> None:
        """Advance all worlds by physics steps; forces are of the last one, positions and velocities of its end.

        Raises:
            RuntimeError: as ``check`` does, unless ``now`` are tensors: asking would wait for the device.
        """
        ...

    def check(self) -> None:
        """Refuse to go on where steps so far have been no physics.

        Raises:
            RuntimeError: where a world has had more contacts or constraints than the engine has room for.
        """
        ...


def make_engine(
    engine: str, model: mujoco.MjModel, num_worlds: int, num_threads: int, *, on_device: bool = False
) -> Engine:
    """The engine of that name.

    Args:
        engine: one of ``ENGINES``.
        model: what all worlds have in common.
        num_worlds: N.
        num_threads: threads of the host; 0 takes one per core.
        on_device: whether ``now`` are PyTorch's tensors on the engine's device, of single precision, from which
            nothing is copied in a step.

    Raises:
        ValueError: for an unknown engine or device, threads that are to have a device, or more worlds than there is
            memory for.
        RuntimeError: where what the engine needs is not installed.
    """
    check_engine(engine)
    name, _, device = engine.partition(":")
    if name == THREADS:
        if on_device:
            raise ValueError("the engine threads has no device of its own; allowed: warp, or warp:DEVICE")
        from avrgym.simulation.engines.threads import Threads

        return Threads(model, num_worlds, num_threads)
    from avrgym.simulation.engines.warp import Warp

    return Warp(model, num_worlds, num_threads, device, on_device=on_device)


def check_engine(engine: str) -> None:
    """Refuse an engine that there is not.

    Raises:
        ValueError: naming those there are.
    """
    name, colon, device = engine.partition(":")
    if engine != THREADS and (name != WARP or bool(colon) != bool(device)):
        raise ValueError(f"unknown engine {engine!r}; allowed: {ENGINES}")


def check_ready(engine: str) -> None:
    """Refuse an engine that cannot compute here.

    Raises:
        ValueError: for an unknown engine or device.
        RuntimeError: where what the engine needs is not installed.
    """
    check_engine(engine)
    if engine != THREADS:
        from avrgym.simulation.engines.warp import find_device

        find_device(engine.partition(":")[2])


def check_memory(num_worlds: int, bytes_per_world: int, free_bytes: int | None, where: str) -> None:
    """Refuse more worlds than there is memory for.

    Raises:
        ValueError: naming how many there is memory for.
    """
    if free_bytes is not None and num_worlds * bytes_per_world > free_bytes:
        raise ValueError(
            f"{num_worlds} worlds take {num_worlds * bytes_per_world / 2**30:.1f} GiB of memory on {where}; "
            f"allowed: up to {free_bytes // bytes_per_world}"
        )


def check_host_memory(num_worlds: int, model: mujoco.MjModel) -> None:
    """Refuse more worlds than the host has memory for; see ``check_memory``."""
    check_memory(num_worlds, int(mujoco.MjData(model).nbuffer), available_bytes(), "this computer")
