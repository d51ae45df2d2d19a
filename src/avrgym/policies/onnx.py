"""Controllers as ONNX files, run on the processor. Needs the extra ``onnx``."""

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import FloatArray
from avrgym.policies.controllers import Foreign
from avrgym.policies.trained import PolicyError

ONNX_SUFFIX = ".onnx"
DTYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64}


class OnnxController:
    """A network without memory: one input, the observation as it is, and one output, the action."""

    def __init__(self, session: Any) -> None:
        """Run an ``onnxruntime.InferenceSession`` that ``find_onnx`` has checked."""
        (given,) = session.get_inputs()
        self._session, self._input = session, given.name
        self._dtype, self._rows = DTYPES[given.type], len(given.shape) == 2

    def reset(self, seed: int, environment: str) -> None:
        """Nothing is remembered, and nothing is chance."""

    def act(self, observation: FloatArray) -> ArrayLike:
        """The network's output for an observation (O,)."""
        given = observation.astype(self._dtype)
        (action,) = self._session.run(None, {self._input: given[None] if self._rows else given})
        return action[0] if self._rows else action


def find_onnx(
    path: str | os.PathLike[str], environment_id: str, observation_size: int, action_size: int
) -> Foreign:
    """Load a network for an environment whose observations and actions have the given sizes.

    Raises:
        PolicyError: without the extra, for a damaged file, and for other inputs or outputs.
    """
    try:
        import onnxruntime
    except ModuleNotFoundError as error:
        raise PolicyError(f"{path}: `pip install avrgym[onnx]` brings what ONNX files need") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(os.fspath(path), options, ["CPUExecutionProvider"])
    except Exception as error:  # the runtime's exceptions have no common base but this
        raise PolicyError(f"{path}: not a readable .onnx file ({' '.join(str(error).split())})") from error
    for kind, ends, size in (
        ("input", session.get_inputs(), observation_size),
        ("output", session.get_outputs(), action_size),
    ):
        _check(path, environment_id, kind, list(ends), size)
    return Foreign(os.fspath(path), lambda: OnnxController(session))


def _check(path: str | os.PathLike[str], environment_id: str, kind: str, ends: list[Any], size: int) -> None:
    """Refuse all but one tensor of shape (size,), (1, size) or (any, size)."""
    if len(ends) == 1 and ends[0].type in DTYPES and _fits(ends[0].shape, size):
        return
    found = ", ".join(f"{end.name} {end.type} {end.shape}" for end in ends)
    raise PolicyError(
        f"{path}: {kind}s {found or 'none'}; {environment_id} takes one {kind} of float or double, "
        f"of shape ({size},), (1, {size}) or (N, {size})"
    )


def _fits(shape: list[Any], size: int) -> bool:
    """Whether a tensor holds one row; sizes that a file leaves open are names or None."""
    *rows, last = shape or [0]
    return len(rows) <= 1 and last == size and all(row == 1 or not isinstance(row, int) for row in rows)
