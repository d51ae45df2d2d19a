"""Trained policies as ONNX graphs, for programs that run networks. Needs the extra ``onnx``."""

from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from avrgym.policies.trained import Policy, PolicyError
from avrgym.system.files import write_atomically

OPSET, IR_VERSION = 17, 8
"""Old enough for programs of 2022."""


def onnx_model(policy: Policy, rows: int | str | None = "N", *, double: bool = True) -> onnx.ModelProto:
    """A policy's mean action (``rows``, A), clipped to ±1, for observations (``rows``, O), normalisation included.

    The chance that a policy acts with is no part of the graph. ``rows`` may be a name for any number; numbers are 64
    bits wide if ``double``, else 32.

    Raises:
        PolicyError: for a policy with a memory, which such a graph has not.
    """
    if policy.memory is not None:
        raise PolicyError(
            "a policy that remembers cannot be written as ONNX; its .safetensors file runs as it is"
        )
    dtype, kind = (np.float64, TensorProto.DOUBLE) if double else (np.float32, TensorProto.FLOAT)
    constants: dict[str, np.ndarray] = {
        "mean": policy.observation_mean,
        "deviation": np.sqrt(policy.observation_variance + policy.observation_epsilon),
        "low": np.array(-policy.observation_clip),
        "high": np.array(policy.observation_clip),
        "least": np.array(-1.0),
        "most": np.array(1.0),
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
        nodes.append(helper.make_node("Add", [f"product{i}", f"bias{i}"], [f"sum{i}"]))
        if i < last:
            nodes.append(helper.make_node("Tanh", [f"sum{i}"], [f"row{i + 1}"]))
    nodes.append(helper.make_node("Clip", [f"sum{last}", "least", "most"], ["action"]))
    graph = helper.make_graph(
        nodes,
        "policy",
        [helper.make_tensor_value_info("observation", kind, [rows, policy.observation_size])],
        [helper.make_tensor_value_info("action", kind, [rows, policy.action_size])],
        [numpy_helper.from_array(array.astype(dtype), name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    about = policy.metadata
    trained = {"environment": about.environment, "people": about.people, "impairment": about.impairment}
    numbers = {"steps": about.steps, "seed": about.seed, "action_std": policy.action_std}
    helper.set_model_props(model, {name: str(value) for name, value in {**trained, **numbers}.items()})
    return model


def write_onnx(policy: Policy, out: Path) -> None:
    """Write a policy into a new file.

    Raises:
        ValueError: for another ending than ``.onnx``.
        FileExistsError: when there is such a file.
    """
    if out.suffix != ".onnx":
        raise ValueError(f"{out}: the name must end in .onnx")
    if out.exists():
        raise FileExistsError(f"{out} exists already; choose another name")
    model = onnx_model(policy)
    onnx.checker.check_model(model)  # pyright: ignore[reportUnknownMemberType]
    write_atomically(out, model.SerializeToString())
