"""A batch of MuJoCo worlds that detects a fork of the process. The threads of the parent do not exist in a forked
process.
"""

import ctypes
import os
from typing import Any
from weakref import WeakSet

import mujoco
from mujoco.batch import Batch

_LIVING: "WeakSet[ForkSafeBatch]" = WeakSet()


class ForkSafeBatch(Batch):
    """A batch of worlds that raises an error in a forked process. Without the error, the batch would wait for missing
    threads.

    A batch with one thread works in the parent and in the forked process.
    """

    def __init__(self, model: mujoco.MjModel, nsim: int, nthread: int = 0, persistent: bool = False) -> None:
        super().__init__(model, nsim, nthread, persistent)
        self._process = os.getpid()
        _LIVING.add(self)

    def step(self, *arguments: Any, **named: Any) -> None:
        """Advance the worlds by physics steps, as in MuJoCo's ``Batch``."""
        self._check_process()
        super().step(*arguments, **named)

    def forward(self, *arguments: Any, **named: Any) -> None:
        """Compute quantities that depend on the state, as in MuJoCo's ``Batch``."""
        self._check_process()
        super().forward(*arguments, **named)

    def reset(self, *arguments: Any, **named: Any) -> None:
        """Reset worlds to their initial states, as in MuJoCo's ``Batch``."""
        self._check_process()
        super().reset(*arguments, **named)

    def set_const(self, *arguments: Any, **named: Any) -> None:
        """Compute constants of the models, as in MuJoCo's ``Batch``."""
        self._check_process()
        super().set_const(*arguments, **named)

    def _check_process(self) -> None:
        if self.nthread > 1 and os.getpid() != self._process:
            raise RuntimeError(
                "the environment was created before the process forked, so its threads do not exist in this process; "
                "create the environment in this process, use copy.deepcopy(env), or start processes with "
                'multiprocessing.get_context("spawn")'
            )


def _keep_forever() -> None:
    """Prevents the deletion of the parent's batches in a forked process. A deletion would wait for threads that do not
    exist there.
    """
    for batch in _LIVING:
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(batch))


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_keep_forever)
