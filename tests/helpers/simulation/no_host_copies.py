"""Whatever would bring a tensor's numbers to the host, or wait for them, forbidden: on a processor's tensors too."""

from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

import pytest
import torch
import warp  # pyright: ignore[reportMissingImports]
from torch.utils._python_dispatch import TorchDispatchMode

WAYS = ("cpu", "numpy", "item", "tolist", "__array__", "__bool__", "__float__", "__int__", "__index__")
"""Of a tensor to the host."""
WAITING = ("_local_scalar_dense", "nonzero", "masked_select", "equal", "_unique2", "unique_dim")
"""What PyTorch cannot compute without knowing numbers of the device."""


class HostCopyError(AssertionError):
    """Something asked for a number of the device."""


class _Watch(TorchDispatchMode):
    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        masks = name in ("index", "index_put", "index_put_") and any(
            each is not None and each.dtype is torch.bool for each in args[1]
        )
        if name in WAITING or masks:
            raise HostCopyError(name)
        return func(*args, **(kwargs or {}))


@contextmanager
def forbid_host_copies() -> Generator[None]:
    """Raise ``Copied`` for each way to the host that is taken within."""

    def refuse(name: str) -> Any:
        def refused(*_: Any, **__: Any) -> Any:
            raise HostCopyError(name)

        return refused

    with pytest.MonkeyPatch.context() as patch, _Watch():
        for name in WAYS:
            patch.setattr(torch.Tensor, name, refuse(name))
        patch.setattr(warp.array, "numpy", refuse("numpy of an array of Warp"))
        yield
