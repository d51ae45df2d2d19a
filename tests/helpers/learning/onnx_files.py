"""Policies as ONNX files of every shape."""

from pathlib import Path

import onnx

from avrgym.policies.onnx import onnx_model
from avrgym.policies.trained import Policy


def save_onnx(policy: Policy, path: Path, rows: int | str | None, *, double: bool) -> None:
    """Write a policy's mean action as a graph that takes so many rows at a time."""
    onnx.save(onnx_model(policy, rows, double=double), path)
