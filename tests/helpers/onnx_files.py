"""Policies written as ONNX graphs, node by node."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from avrgym.policies.trained import Policy


def as_onnx(policy: Policy, path: Path, rows: int | str | None, *, double: bool) -> None:
    """Write a policy's mean action, normalisation included, as a graph that takes so many rows at a time."""
    dtype, kind = (np.float64, TensorProto.DOUBLE) if double else (np.float32, TensorProto.FLOAT)
    constants: dict[str, np.ndarray] = {
        "mean": policy.observation_mean,
        "deviation": np.sqrt(policy.observation_variance + policy.observation_epsilon),
        "low": np.array(-policy.observation_clip),
        "high": np.array(policy.observation_clip),
    }
    nodes = [
        helper.make_node("Sub", ["observation", "mean"], ["centred"]),
        helper.make_node("Div", ["centred", "deviation"], ["scaled"]),
        helper.make_node("Clip", ["scaled", "low", "high"], ["row0"]),
    ]
    last = len(policy.weights) - 1
    for i, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        constants |= {f"weight{i}": weight, f"bias{i}": bias}
        nodes.append(helper.make_node("MatMul", [f"row{i}", f"weight{i}"], [f"product{i}"]))
        nodes.append(
            helper.make_node("Add", [f"product{i}", f"bias{i}"], ["action" if i == last else f"sum{i}"])
        )
        if i < last:
            nodes.append(helper.make_node("Tanh", [f"sum{i}"], [f"row{i + 1}"]))
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", kind, [rows, policy.observation_size])],
        [helper.make_tensor_value_info("action", kind, [rows, policy.action_size])],
        [numpy_helper.from_array(array.astype(dtype), name) for name, array in constants.items()],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8), path)
