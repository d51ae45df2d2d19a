"""Conversion of arrays to PyTorch tensors."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
import torch


def as_tensors(value: Any, device: str = "cpu") -> Any:
    """Convert arrays, also in dataclasses, mappings and tuples, to tensors."""
    return _each(value, lambda array: torch.tensor(array).to(device))


def single_precision(value: Any) -> Any:
    """Convert floating-point tensors, also in dataclasses, mappings and tuples, to single precision."""
    return _each(value, lambda tensor: tensor.float() if tensor.dtype.is_floating_point else tensor)


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(value, Mapping):
        return {name: _each(each, change) for name, each in value.items()}
    if isinstance(value, tuple):
        return tuple(_each(each, change) for each in value)
    if is_dataclass(value) and not isinstance(value, type):
        return type(value)(**{each.name: _each(getattr(value, each.name), change) for each in fields(value)})
    return change(value)


def assert_tensors_close(found: Any, wanted: Any, where: str = "") -> None:
    """Assert that tensors equal arrays to 1e-5, also in dataclasses, mappings and tuples."""
    if isinstance(wanted, Mapping):
        assert list(found) == list(wanted), where
        for name, each in wanted.items():
            assert_tensors_close(found[name], each, f"{where}.{name}")
    elif isinstance(wanted, tuple):
        for number, (one, other) in enumerate(zip(found, wanted, strict=True)):
            assert_tensors_close(one, other, f"{where}[{number}]")
    elif is_dataclass(wanted):
        for each in fields(wanted):
            assert_tensors_close(
                getattr(found, each.name), getattr(wanted, each.name), f"{where}.{each.name}"
            )
    else:
        assert isinstance(found, torch.Tensor), where
        assert found.dtype.is_floating_point == (np.asarray(wanted).dtype.kind == "f"), where
        np.testing.assert_allclose(found.numpy(), wanted, rtol=1e-5, atol=1e-5, err_msg=where)
