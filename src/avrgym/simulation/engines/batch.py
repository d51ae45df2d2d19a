"""MuJoCo's batch, safe where a process forks: its threads stay in the process that made them."""

import ctypes
import os
from typing import Any
from weakref import WeakSet

import mujoco
from mujoco.batch import Batch

_LIVING: "WeakSet[ForkSafeBatch]" = WeakSet()


class ForkSafeBatch(Batch):
    """A batch whose calls are refused in a forked process, where they would wait for threads that are not there.

    A batch of one thread works in both processes.
    """

    def __init__(self, model: mujoco.MjModel, nsim: int, nthread: int = 0, persistent: bool = False) -> None:
        super().__init__(model, nsim, nthread, persistent)
        self._process = os.getpid()
        _LIVING.add(self)

    def step(self, *arguments: Any, **named: Any) -> None:
        """See ``Batch``."""
        self._check_process()
        super().step(*arguments, **named)

    def forward(self, *arguments: Any, **named: Any) -> None:
        """See ``Batch``."""
        self._check_process()
        super().forward(*arguments, **named)

    def reset(self, *arguments: Any, **named: Any) -> None:
        """See ``Batch``."""
        self._check_process()
        super().reset(*arguments, **named)

    def set_const(self, *arguments: Any, **named: Any) -> None:
        """See ``Batch``."""
        self._check_process()
        super().set_const(*arguments, **named)

    def _check_process(self) -> None:
        if self.nthread > 1 and os.getpid() != self._process:
            raise RuntimeError(
                "these worlds were made before the process forked, and their threads are not in this process; "
                "make the environment here, go on with copy.deepcopy(env), or start processes by "
                'multiprocessing.get_context("spawn")'
            )


def _keep_forever() -> None:
    """In a forked process: never free a batch of the other process, which would wait for its threads to end."""
    for batch in _LIVING:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(batch))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_forever)
