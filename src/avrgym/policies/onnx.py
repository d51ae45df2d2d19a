"""ONNX files: networks of other programs as controllers, and export of policies. Needs the extra ``onnx``."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.models.cameras import COMMAND_ENTRY, STATE_ENTRY
from avrgym.policies.controllers import ExternalController
from avrgym.policies.trained_policies import Policy, PolicyError
from avrgym.safety.pacing import COMMAND_INPUT_ENTRIES
from avrgym.system.files import write_atomically

if TYPE_CHECKING:
    from onnx import ModelProto

ONNX_SUFFIX = ".onnx"
ONNX_OPSET_VERSION, ONNX_IR_VERSION = 17, 8
"""Operator set and format version of exported ONNX files. Programs since 2022 support them."""
ONNX_DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}


class OnnxController:
    """A feed-forward network of an ONNX file as controller. Its input is the observation without normalisation; its
    output is the action.

    A second input ``command`` receives the participant's latest command, see ``safety.pacing.COMMAND_INPUT_ENTRIES``.
    """

    def __init__(self, session: Any) -> None:
        """``session`` is an ``onnxruntime.InferenceSession`` that ``load_onnx_controller`` has checked."""
        self._session = session
        self._inputs = {
            COMMAND_ENTRY if tensor.name == COMMAND_ENTRY else STATE_ENTRY: (
                tensor.name,
                ONNX_DTYPES[tensor.type],
                len(tensor.shape) == 2,
            )
            for tensor in session.get_inputs()
        }

    def reset(self, seed: int, environment: str) -> None:
        """Does nothing: the network has no memory and no noise."""

    def act(self, observation: FloatArray | Mapping[str, FloatArray]) -> ArrayLike:
        """Returns the network's output (A,) for an observation (O,), or for a dictionary with ``command``."""
        given = observation if isinstance(observation, Mapping) else {STATE_ENTRY: observation}
        feed = {
            name: (given[entry][None] if rows else given[entry]).astype(dtype)
            for entry, (name, dtype, rows) in self._inputs.items()
        }
        (action,) = self._session.run(None, feed)
        return action[0] if self._inputs[STATE_ENTRY][2] else action


def load_onnx_controller(
    path: str | os.PathLike[str], environment_id: str, observation_size: int, action_size: int
) -> ExternalController:
    """Load a network file. Returns it as a controller for an environment with the given observation and action size.

    Raises:
        PolicyError: if the extra is missing, the file is damaged, or its inputs or outputs have wrong shapes.
    """
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise PolicyError(
            f"{path}: the package onnxruntime is missing; run `pip install avrgym[onnx]`"
        ) from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(os.fspath(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # the runtime's exceptions have no other common base
        raise PolicyError(
            f"{path}: not a readable .onnx file ({' '.join(str(error).split())}); export the policy again"
        ) from error
    inputs = list(session.get_inputs())
    commands = [tensor for tensor in inputs if tensor.name == COMMAND_ENTRY]
    for kind, tensors, size in (
        ("input", [tensor for tensor in inputs if tensor not in commands], observation_size),
        ("output", list(session.get_outputs()), action_size),
        *([(COMMAND_ENTRY, commands, len(COMMAND_INPUT_ENTRIES))] if commands else []),
    ):
        _check(path, environment_id, kind, tensors, size)
    return ExternalController(os.fspath(path), lambda: OnnxController(session), takes_commands=bool(commands))


def _check(
    path: str | os.PathLike[str], environment_id: str, kind: str, tensors: list[Any], size: int
) -> None:
    """Raises ``PolicyError`` if ``tensors`` is not one tensor of shape (size,), (1, size) or (any, size)."""
    if len(tensors) == 1 and tensors[0].type in ONNX_DTYPES and _fits(tensors[0].shape, size):
        return
    found = ", ".join(f"{each.name} {each.type} {each.shape}" for each in tensors)
    raise PolicyError(
        f"{path}: the network's {kind}s are {found or 'none'}; allowed for {environment_id}: one {kind} of float or "
        f"double, of shape ({size},), (1, {size}) or (N, {size})"
    )


def _fits(shape: list[Any], size: int) -> bool:
    """Returns whether a tensor of this shape can contain one row of ``size`` numbers.

    In ``shape``, variable sizes are names or None.
    """
    *rows, last = shape or [0]
    return len(rows) <= 1 and last == size and all(row == 1 or not isinstance(row, int) for row in rows)


def make_onnx_model(policy: Policy, rows: int | str | None = "N", *, double: bool = True) -> "ModelProto":
    """Returns an ONNX model of a policy: mean actions (``rows``, A), clipped to ±1, for observations (``rows``, O).

    The model contains the normalisation, but no exploration noise. If ``rows`` is a name, the number of rows is
    variable. ``double``: whether the inputs have double precision instead of single precision.

    Raises:
        PolicyError: for a recurrent policy, or a policy with vision.
    """
    from onnx import TensorProto, helper, numpy_helper

    if policy.vision is not None:
        raise PolicyError("a policy with vision cannot be exported to ONNX; use its .safetensors file")
    if policy.memory is not None:
        raise PolicyError("a recurrent policy cannot be exported to ONNX; use its .safetensors file")
    dtype, kind = (np.float64, TensorProto.DOUBLE) if double else (np.float32, TensorProto.FLOAT)
    constants: dict[str, np.ndarray] = {
        "mean": policy.observation_mean,
        "deviation": policy.observation_std,
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
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", ONNX_OPSET_VERSION)], ir_version=ONNX_IR_VERSION
    )
    about = policy.metadata
    trained = {"environment": about.environment, "people": about.people, "impairment": about.impairment}
    numbers = {"steps": about.steps, "seed": about.seed, "action_std": policy.action_std}
    helper.set_model_props(model, {name: str(value) for name, value in {**trained, **numbers}.items()})
    return model


def write_onnx(policy: Policy, out: Path) -> None:
    """Write a policy into a new ONNX file.

    Raises:
        ValueError: if the suffix is not ``.onnx``.
        FileExistsError: if the file exists.
    """
    import onnx

    if out.suffix != ".onnx":
        raise ValueError(f"the file name {out} does not end in .onnx; choose a name such as policy.onnx")
    if out.exists():
        raise FileExistsError(f"{out} already exists; choose another name")
    model = make_onnx_model(policy)
    onnx.checker.check_model(model)  # pyright: ignore[reportUnknownMemberType]
    write_atomically(out, model.SerializeToString())
