"""ONNX files of policies."""

from pathlib import Path

import onnx

from avrgym.policies.onnx import make_onnx_model
from avrgym.policies.trained_policies import Policy


def save_onnx(policy: Policy, path: Path, rows: int | str | None, *, double: bool) -> None:
    """Save a policy's mean action as an ONNX graph with a batch size of ``rows``."""
    onnx.save(make_onnx_model(policy, rows, double=double), path)
