"""Forbids copies of tensors to the host and waiting for the device, also for CPU tensors."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
import warp  # pyright: ignore[reportMissingImports]
from torch.utils._python_dispatch import TorchDispatchMode

HOST_COPIES = ("cpu", "numpy", "item", "tolist", "__array__", "__bool__", "__float__", "__int__", "__index__")
"""Methods that copy a tensor to the host."""
WAITING_OPERATIONS = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "_unique2", "unique_dim")
"""PyTorch operations that wait for values of the device."""


class HostCopyError(AssertionError):
    """An operation needs a value of the device on the host."""


class _ForbidWaiting(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        masks = name in ("index", "index_put", "index_put_") and any(
            each is not None and each.dtype is torch.bool for each in args[1]
        )
        if name in WAITING_OPERATIONS or masks:
            raise HostCopyError(name)
        return func(*args, **(kwargs or {}))


@contextmanager
def forbid_host_copies() -> Generator[None]:
    """Raise ``HostCopyError`` for each copy to the host in this context."""

    def forbid(name: str) -> Any:
        def raise_error(*_: Any, **__: Any) -> Any:
            raise HostCopyError(name)

        return raise_error

    with pytest.MonkeyPatch.context() as patch, _ForbidWaiting():
        for name in HOST_COPIES:
            patch.setattr(torch.Tensor, name, forbid(name))
        patch.setattr(warp.array, "numpy", forbid("numpy of an array of Warp"))
        yield
