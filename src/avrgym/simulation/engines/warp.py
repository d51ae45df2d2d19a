"""MuJoCo Warp: steps the worlds of a batch on a GPU, in single precision. Needs the extra ``gpu``.

The host computes initial states, in double precision. ``copy_from_host`` copies worlds and their model fields to the
device. Code on the device reads and writes Warp's memory as tensors, without copies. Warp compiles its kernels at the
first step of a scene and caches them on disk.
"""

from copy import copy
from dataclasses import Field, fields
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

import mujoco
from mujoco.batch import MODEL_FIELDS, Batch

from avrgym.array_types import IntArray, NumpyArray
from avrgym.geometry.arrays import to_numpy
from avrgym.models.collision_bits import PARTICLE
from avrgym.simulation.engines.batch import ForkSafeBatch
from avrgym.simulation.engines.engine import (
    WORLD_ARRAY_NAMES,
    WRITABLE_ARRAY_NAMES,
    WorldArrays,
    check_host_memory,
    check_memory,
)
from avrgym.system.engine_names import WARP
from avrgym.system.memory import get_available_memory_bytes

CONTACTS_PER_WORLD, CONTACTS_PER_PARTICLE = 96, 8
"""Number of contacts for which a world has memory, and number of additional contacts per particle. Both are about twice
the maximum in the task Drinking.
"""
CONSTRAINT_ROWS_PER_CONTACT = 4
"""Number of constraint rows per contact: one for each side of the pyramid that approximates the friction cone."""
MAX_SENSOR_CONTACTS = 96
"""Maximum number of contacts that one contact sensor compares to find the strongest contacts."""
HARMLESS_OVERFLOWS = ("ITERATIONS", "LS_ITERATIONS")
"""Flags in Warp's ``overflow`` that report no memory overflow: the solver reached its maximum number of iterations."""


class _Libraries(NamedTuple):
    warp: Any
    mujoco_warp: Any
    torch: Any


@cache
def import_libraries() -> _Libraries:
    """Imports and returns the packages of the extra ``gpu``.

    Raises:
        RuntimeError: if the extra is not installed.
    """
    try:
        warp, torch = import_module("warp"), import_module("torch")
        warp.config.log_level = warp.LOG_ERROR
        return _Libraries(warp, import_module("mujoco_warp"), torch)
    except ModuleNotFoundError as error:
        raise RuntimeError(
            f"engine 'warp' needs the package {error.name}, which is missing; run `pip install avrgym[gpu]`"
        ) from error


class WarpEngine:
    """An ``Engine`` on a GPU. ``world_arrays`` contains tensors of Warp's memory, or host copies that each step
    updates.
    """

    name = WARP

    def __init__(
        self, model: mujoco.MjModel, num_worlds: int, num_threads: int, device: str, *, on_device: bool
    ) -> None:
        """Create the worlds. ``device`` is Warp's name of the device; an empty name is the first GPU.

        Raises:
            ValueError: for an unknown device, or more worlds than memory allows.
            RuntimeError: if the extra is not installed.
        """
        self._warp, self._mujoco_warp, self._torch = import_libraries()
        self._device = find_device(device)
        self.device, self._num_worlds = str(self._device.name), num_worlds
        self._capacity = WorldCapacity.from_model(model)
        check_host_memory(num_worlds, model)
        check_memory(num_worlds, self._bytes_per_world(model), self._free_bytes(), self.device)
        self.batch: Batch = ForkSafeBatch(model, num_worlds, num_threads)
        self._host, self._warm_start = WorldArrays.from_batch(self.batch), self.batch.bind("qacc_warmstart")
        self._data = self._made(model, num_worlds)
        host = self._host
        self._there = {name: self._tensor(name).view(getattr(host, name).shape) for name in WORLD_ARRAY_NAMES}
        self._on_device = on_device
        self.world_arrays = WorldArrays(
            **(self._there if on_device else {name: getattr(host, name).copy() for name in WORLD_ARRAY_NAMES})
        )
        self._model: Any = None
        self._varying: dict[str, Any] = {}
        self._graphs: dict[int, Any] = {}

    def copy_from_host(self, ids: IntArray) -> None:
        """Copy models and states from ``batch`` to the device, see ``Engine.copy_from_host``.

        Raises:
            RuntimeError: if a buffer has overflowed since the last check, see ``check_overflow``.
        """
        if self._model is None:
            self._make_model()
        self.check_overflow()
        rows = self._torch.as_tensor(ids, device=self._place)
        for name, field in self._varying.items():
            values = self.batch.expanded(name)
            assert values is not None
            self._put(field, rows, values[ids])
        self._put(self._tensor("qacc_warmstart"), rows, self._warm_start[ids])
        for name in WORLD_ARRAY_NAMES:
            values = getattr(self._host, name)[ids]
            self._put(self._there[name], rows, values)
            if not self._on_device:
                getattr(self.world_arrays, name)[ids] = values

    def copy_to_host(self, ids: IntArray) -> None:
        """Copy states to ``batch``, see ``Engine.copy_to_host``. Also computes all quantities that depend on them."""
        for name in WRITABLE_ARRAY_NAMES:
            getattr(self._host, name)[ids] = to_numpy(getattr(self.world_arrays, name))[ids]
        self._warm_start[ids] = to_numpy(self._tensor("qacc_warmstart"))[ids]
        self.batch.forward(ids, stage=mujoco.mjtStage.mjSTAGE_VEL)

    def step(self, substeps: int) -> None:
        """Advance all worlds by physics steps, see ``Engine.step``."""
        if self._on_device:
            self._run(substeps)
            return
        for name in WRITABLE_ARRAY_NAMES:
            self._there[name].copy_(self._torch.as_tensor(getattr(self.world_arrays, name)))
        self._run(substeps)
        for name in WORLD_ARRAY_NAMES:
            getattr(self.world_arrays, name)[:] = to_numpy(self._there[name])
        self.check_overflow()

    def step_with_controls(self, columns: Any, values: Any) -> None:
        """Advance all worlds by K physics steps, see ``Engine.step_with_controls``."""
        for each in values:
            self.world_arrays.ctrl[:, columns] = each
            self.step(1)

    def _run(self, substeps: int) -> None:
        """Run physics steps. On a GPU, the first call captures a CUDA graph. Later calls replay it.

        The replay of a graph requires constant memory addresses.
        """
        if not self._device.is_cuda:
            self._launch(substeps)
            return
        stream = self._warp.get_stream(self._device)
        torchs = self._torch.cuda.current_stream(self._place)
        stream.wait_stream(self._warp.stream_from_torch(torchs))
        if substeps in self._graphs:
            self._warp.capture_launch(self._graphs[substeps], stream=stream)
        else:
            self._launch(substeps)
            with self._warp.ScopedCapture(self._device) as capture:
                self._launch(substeps)
            self._graphs[substeps] = capture.graph
        torchs.wait_stream(self._warp.stream_to_torch(stream))

    def _launch(self, substeps: int) -> None:
        simulation, model, data = self._mujoco_warp, self._model, self._data
        with self._warp.ScopedDevice(self._device):
            for _ in range(substeps):
                simulation.step(model, data)
            simulation.fwd_kinematics(model, data)
            simulation.com_vel(model, data)
            simulation.sensor_vel(model, data)

    def _make_model(self) -> None:
        """Create the model on the device, with a row for each world in every field that differs between worlds."""
        model = copy(self.batch.model)
        no_trees_of_geoms = int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)  # Warp rejects this flag
        model.opt.disableflags &= ~no_trees_of_geoms
        names = [each.name for each in fields(self._mujoco_warp.Model) if _has_worlds(each)]
        varying = [name for name in names if self.batch.expanded(name) is not None]
        with self._warp.ScopedDevice(self._device):
            self._model = self._mujoco_warp.put_model(model, dict.fromkeys(varying, self._num_worlds))
        self._model.opt.contact_sensor_maxmatch = MAX_SENSOR_CONTACTS
        self._model.opt.warn_overflow = 0
        self._model.callback.contactfilter = import_module(
            "avrgym.simulation.engines.contact_corrections"
        ).correct_contacts
        self._varying = {name: self._warp.to_torch(getattr(self._model, name)) for name in varying}

    def _made(self, model: mujoco.MjModel, num_worlds: int) -> Any:
        with self._warp.ScopedDevice(self._device):
            return self._mujoco_warp.make_data(
                model, num_worlds, nconmax=self._capacity.contacts, njmax=self._capacity.constraint_rows
            )

    def check_overflow(self) -> None:
        """Check the overflow flags of all worlds, see ``Engine.check_overflow``."""
        flags = self._data.overflow.numpy()
        kinds = [kind for kind in self._mujoco_warp.OverflowType if kind.name not in HARMLESS_OVERFLOWS]
        counts = {kind.name: int(((flags & kind.value) != 0).sum()) for kind in kinds}
        told = ", ".join(f"{name} in {count}" for name, count in counts.items() if count)
        if told:
            self._data.overflow.zero_()
            raise RuntimeError(
                f"buffers of engine 'warp' overflowed: {told} of {len(flags)} worlds; use fewer particles or engine "
                f"'threads'. Each world has memory for "
                f"{self._capacity.contacts} contacts and {self._capacity.constraint_rows} rows of constraints"
            )

    def _bytes_per_world(self, model: mujoco.MjModel) -> int:
        one = self._made(model, 1)
        parts = [getattr(of, each.name) for of in (one, one.contact, one.efc) for each in fields(of)]
        return sum(int(part.capacity) for part in parts if isinstance(part, self._warp.array))

    def _free_bytes(self) -> int | None:
        return int(self._device.free_memory) if self._device.is_cuda else get_available_memory_bytes()

    @property
    def _place(self) -> str:
        """Returns the name of the engine's device in PyTorch, such as ``cuda:0``."""
        return str(self._warp.device_to_torch(self._device))

    def _tensor(self, name: str) -> Any:
        """Returns an array (N, ...) of Warp's data as a tensor that shares its memory."""
        return self._warp.to_torch(getattr(self._data, name))

    def _put(self, tensor: Any, rows: Any, values: NumpyArray) -> None:
        tensor[rows] = self._torch.as_tensor(values, dtype=tensor.dtype, device=self._place).reshape(
            len(values), *tensor.shape[1:]
        )


def _has_worlds(field: Field[Any]) -> bool:
    """Returns whether MuJoCo's batch and Warp both support a field that differs between worlds."""
    return field.name in MODEL_FIELDS and tuple(getattr(field.type, "shape", ()))[:1] == ("*",)


class WorldCapacity(NamedTuple):
    """Numbers for which Warp allocates memory in each world: mean number of contacts, and maximum number of constraint
    rows.
    """

    contacts: int
    constraint_rows: int

    @classmethod
    def from_model(cls, model: mujoco.MjModel) -> "WorldCapacity":
        """Returns the capacity that each world of a model needs."""
        contacts = CONTACTS_PER_WORLD + CONTACTS_PER_PARTICLE * int(
            (model.geom_contype == PARTICLE.contype).sum()
        )
        return cls(contacts, CONSTRAINT_ROWS_PER_CONTACT * contacts + 2 * int(model.njnt))


def _first_gpu(torch: Any) -> str:
    """Returns the name of the first GPU.

    Raises:
        ValueError: if PyTorch finds no GPU.
    """
    if not torch.cuda.is_available():
        raise ValueError(
            "engine 'warp' needs a CUDA device, and PyTorch finds none; allowed: 'threads', or 'warp:cpu' (much slower "
            "than 'threads')"
        )
    return "cuda:0"


def find_device(name: str) -> Any:
    """Returns the device with this Warp name. An empty name is the first GPU.

    Raises:
        ValueError: for an unknown device. The message lists the available devices.
        RuntimeError: if the extra is not installed.
    """
    warp, _, torch = import_libraries()
    name = name or _first_gpu(torch)
    try:
        return warp.get_device(name)
    except ValueError as error:
        known = ", ".join(str(device) for device in warp.get_devices())
        raise ValueError(f"engine 'warp' has no device {name!r}; allowed: {known}") from error
