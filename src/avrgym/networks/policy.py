"""Policies in NumPy, and their files: policies of robots and of trained humans.

A policy consists of an observation normaliser, optional vision or memory, tanh layers, and the standard deviation of
actions. Its file is a safetensors file: numbers and a text header, never code. The header contains the metadata of the
training run, and whether the policy controls a human.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields
from hashlib import sha256
from pathlib import Path
from typing import Any, cast

import msgspec
import numpy as np
import safetensors
import safetensors.numpy

from avrgym.geometry import elementary
from avrgym.networks.layers import GatedRecurrentUnit, copy_read_only, multiply_matrices
from avrgym.networks.vision import VISION_TENSOR_NAMES, VisionNetwork
from avrgym.system.files import write_atomically
from avrgym.system.used_plugins import UsedPlugin

FEEDFORWARD_FORMAT_VERSION, RECURRENT_FORMAT_VERSION, VISUAL_FORMAT_VERSION = 2, 3, 4
"""Versions of the file format: for feed-forward policies, recurrent policies, and policies with vision."""
POLICY_FILE_SUFFIX = ".safetensors"

_HEADER = "avrgym_policy"
_ACTION_STD = "action.deviation"
_FIXED_TENSORS = (
    "observation.mean",
    "observation.variance",
    "observation.clip",
    "observation.epsilon",
    _ACTION_STD,
)
_MEMORY_TENSORS = {each.name: f"memory.{each.name}" for each in fields(GatedRecurrentUnit)}
_DTYPES = ("F32", "F64")


class PolicyError(ValueError):
    """Raised if a policy cannot be loaded, saved or used. The message contains the error and the allowed values."""


class TrainedHumanMetadata(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metadata of a trained human: a human policy that was trained together with a robot policy.

    ``partner`` is the ``digest`` of the robot policy. ``people_file`` is the text of the people file that determined
    the human's bodies in training, if any.
    """

    partner: str
    people_file: str = ""


class PolicyMetadata(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Metadata of a policy: its training run and its results.

    ``steps`` is the number of environment steps, ``seconds`` the duration of the training run. ``measured`` contains
    results of the final evaluation, such as ``success_rate``. Each point of ``curve`` contains the number of
    environment steps, and mean reward and success rate of the latest episodes. ``human`` is set for a trained human.
    ``plugins`` contains the versions of task and robot if they are in other packages; old files do not contain it.
    ``force_guard`` is true if the force guard was active in training. ``settings`` contains the fields of
    ``tasks.settings.Settings`` that differ from the defaults. ``camera`` is the camera of a policy with vision, such as
    ``wrist:64x64:depth``.
    """

    environment: str
    people: str
    impairment: str = "none"
    steps: int
    seed: int
    git_commit: str = ""
    seconds: float = 0.0
    measured: dict[str, bool | int | float | str] = {}
    curve: list[tuple[int, float, float]] = []
    human: TrainedHumanMetadata | None = None
    plugins: tuple[UsedPlugin, ...] = ()
    force_guard: bool = False
    settings: dict[str, Any] = {}
    camera: str = ""


@dataclass(frozen=True, eq=False)
class Policy:
    """A policy: observation normaliser, optional vision or memory, tanh layers, and normally distributed action noise.

    A policy that was trained with action noise may need this noise to reach its goal. Without noise, the robot may
    stop. All arrays are stored as read-only float64.

    Args:
        weights: One (inputs, outputs) matrix per layer. The input of the first layer is the observation, followed by
            the memory's state.
        biases: One (outputs,) vector per layer.
        observation_mean: mean (observation,) of the observations in training.
        observation_variance: variance (observation,) of the observations in training, not negative.
        observation_clip: Bound of normalised observations, in standard deviations.
        observation_epsilon: Constant that is added to the variance before the square root.
        action_std: Standard deviation of each action; 0 for no noise.
        metadata: Description of the training run.
        memory: A gated recurrent unit. Its input is the normalised observation.
        vision: Replaces entries of the normalised observation by estimates from an image.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    observation_mean: np.ndarray
    observation_variance: np.ndarray
    observation_clip: float
    observation_epsilon: float
    action_std: float
    metadata: PolicyMetadata
    memory: GatedRecurrentUnit | None = None
    vision: VisionNetwork | None = None

    def __post_init__(self):
        for name in ("weights", "biases"):
            object.__setattr__(self, name, tuple(copy_read_only(array) for array in getattr(self, name)))
        for name in ("observation_mean", "observation_variance"):
            object.__setattr__(self, name, copy_read_only(getattr(self, name)))
        _check_numbers(self)
        _check_shapes(self)
        _check_sums(self)

    @property
    def observation_size(self) -> int:
        return self.observation_mean.shape[0]

    @property
    def memory_size(self) -> int:
        """Returns the number of units of the memory; 0 without a memory."""
        return 0 if self.memory is None else self.memory.num_units

    @property
    def action_size(self) -> int:
        return self.weights[-1].shape[1]

    @property
    def parameters_sha256(self) -> str:
        """Returns the SHA-256 hash of all parameters, without metadata, in hexadecimal."""
        digest = sha256()
        for name, array in _tensors(self).items():
            digest.update(f"{name} {array.shape}".encode() + array.astype("<f8").tobytes())
        return digest.hexdigest()

    def act(self, observations: np.ndarray, generators: Sequence[np.random.Generator]) -> np.ndarray:
        """Returns actions (N, action) for observations (N, observation), with noise from the generators: float32 in
        [-1, 1].

        A row's result does not depend on the other rows, bit for bit. Only for policies without memory and vision.
        """
        return self.add_noise(self.compute_mean_actions(observations), generators)

    def compute_mean_actions(self, observations: np.ndarray) -> np.ndarray:
        """Returns mean actions (N, action) before clipping. Only for policies without memory and vision."""
        if self.memory is not None:
            raise PolicyError("the policy is recurrent; compute its actions with `policies.actors.Actor`")
        return self.forward(observations, np.zeros((len(observations), 0)))[0]

    def forward(
        self, observations: np.ndarray, memory: np.ndarray, image: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns mean actions (N, action) for observations (N, observation), and the next memory (N, memory).

        A policy with vision needs an ``image`` (N, H, W, C), from ``vision.make_vision_input``. At the start of an
        episode the memory is zero. Sums have a fixed order: a row's result does not depend on batch size or
        processor, bit for bit.
        """
        if observations.ndim != 2 or observations.shape[1] != self.observation_size:
            raise PolicyError(
                f"observations have the shape {observations.shape}; allowed: (N, {self.observation_size})"
            )
        rows = self.normalise_observations(np.array(observations, np.float64, order="C"))
        if self.vision is not None:
            if image is None:
                raise PolicyError(
                    f"the policy needs images; pass images of the camera {self.metadata.camera}"
                )
            rows = self._clip(self.vision.fill_estimated_entries(rows, image))
        if self.memory is not None:
            memory = self.memory.compute_next_hidden_state(rows, memory)
            rows = np.concatenate([rows, memory], axis=1)
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            rows = elementary.tanh(multiply_matrices(rows, weight) + bias)
        return multiply_matrices(rows, self.weights[-1]) + self.biases[-1], memory

    def add_noise(self, means: np.ndarray, generators: Sequence[np.random.Generator]) -> np.ndarray:
        """Returns actions (N, action), float32 in [-1, 1]: the means plus noise from the generators."""
        if len(generators) != len(means):
            raise PolicyError(
                f"there are {len(generators)} random generators for {len(means)} observations; allowed: one generator "
                "for each observation"
            )
        actions = means.copy()
        for row, generator in enumerate(generators if self.action_std else ()):
            actions[row] += self.action_std * generator.standard_normal(self.action_size)
        return np.clip(actions, -1, 1).astype(np.float32)

    @property
    def observation_std(self) -> np.ndarray:
        """Returns the standard deviations (O,) of observations in training. The normaliser divides observations by
        them.
        """
        return np.sqrt(self.observation_variance + self.observation_epsilon)

    def normalise_observations(self, observations: np.ndarray) -> np.ndarray:
        """Returns observations (N, O) with mean 0 and standard deviation 1 in training, clipped."""
        return self._clip((observations - self.observation_mean) / self.observation_std)

    def _clip(self, rows: np.ndarray) -> np.ndarray:
        return np.clip(rows, -self.observation_clip, self.observation_clip)

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the policy file atomically.

        Raises:
            PolicyError: if the file exists and ``overwrite`` is false.
        """
        path = Path(path)
        if path.exists() and not overwrite:
            raise PolicyError(f"{path} already exists; choose another name, or pass overwrite=True")
        version = FEEDFORWARD_FORMAT_VERSION if self.memory is None else RECURRENT_FORMAT_VERSION
        if self.vision is not None:
            version = VISUAL_FORMAT_VERSION
        header = {"format_version": version, **msgspec.to_builtins(self.metadata)}
        for name in ("human", "plugins", "force_guard", "settings", "camera"):
            if not header[name]:
                del header[name]  # older versions without these fields can still read the files
        numbers = {name: _narrowed(array) for name, array in _tensors(self).items()}
        data = safetensors.numpy.save(numbers, {_HEADER: msgspec.json.encode(header).decode()})
        write_atomically(path, data)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Policy":
        """Read and return a policy. Raises ``PolicyError`` for an invalid file."""
        try:
            with cast(Any, safetensors.safe_open(path, framework="numpy")) as file:
                return _read(file)
        except PolicyError as error:
            raise PolicyError(f"{path}: {error}") from error
        except (OSError, safetensors.SafetensorError) as error:
            raise PolicyError(
                f"{path}: not a readable .safetensors file ({error}); restore a backup"
            ) from error


def _check_numbers(policy: Policy) -> None:
    for name, array in _tensors(policy).items():
        if not np.isfinite(array).all():
            raise PolicyError(f"{name} contains NaN or infinity; allowed: finite numbers")
    positive = {
        "observation.clip": policy.observation_clip,
        "observation.epsilon": policy.observation_epsilon,
    }
    for name, number in positive.items():
        if number <= 0:
            raise PolicyError(f"{name} is {number}; allowed: above 0")
    if (policy.observation_variance < 0).any():
        raise PolicyError("observation.variance contains negative numbers; allowed: 0 and above")
    if policy.action_std < 0:
        raise PolicyError(f"{_ACTION_STD} is {policy.action_std}; allowed: 0 and above")


def _check_sums(policy: Policy) -> None:
    """Raises ``PolicyError`` if the sums of a layer can overflow. The inputs of each layer are bounded, from the second
    layer on by ±1."""
    largest = policy.observation_clip if policy.memory is None else max(policy.observation_clip, 1.0)
    if policy.memory is not None:
        memory = policy.memory
        _check_sum("memory.input", largest, memory.input_weight, memory.input_bias)
        _check_sum("memory.hidden", 1.0, memory.hidden_weight, memory.hidden_bias)
    for layer, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        _check_sum(f"actor.{layer}", largest, weight, bias)
        largest = 1.0


def _check_sum(name: str, largest: float, weight: np.ndarray, bias: np.ndarray) -> None:
    with np.errstate(over="ignore"):
        sums = largest * np.abs(weight).sum(axis=0).max(initial=0.0) + np.abs(bias).max(initial=0.0)
    if not np.isfinite(sums):
        raise PolicyError(
            f"the weighted sums of the layer {name} can overflow; use smaller weights and biases"
        )


def _check_shapes(policy: Policy) -> None:
    if not policy.weights or len(policy.weights) != len(policy.biases):
        raise PolicyError(
            f"the policy has {len(policy.weights)} weight matrices and {len(policy.biases)} bias vectors; allowed: the "
            "same number of both, 1 or more"
        )
    _check_shape("observation.mean", policy.observation_mean, (None,))
    size = policy.observation_mean.shape
    _check_shape("observation.variance", policy.observation_variance, size)
    if (policy.vision is None) != (policy.metadata.camera == ""):
        raise PolicyError(
            "the policy has a vision network but no `camera` in its metadata, or the reverse; allowed: both or neither"
        )
    if policy.vision is not None and policy.memory is not None:
        raise PolicyError("the policy has vision and a memory; allowed: one of them or neither")
    if policy.memory is not None:
        _check_memory(policy.memory, size[0])
        size = (size[0] + policy.memory.num_units,)
    for layer, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        _check_shape(f"actor.{layer}.weight", weight, (*size, None))
        size = weight.shape[1:]
        _check_shape(f"actor.{layer}.bias", bias, size)


def _check_memory(memory: GatedRecurrentUnit, inputs: int) -> None:
    _check_shape("memory.hidden_weight", memory.hidden_weight, (None, None))
    gates = 3 * memory.num_units
    _check_shape("memory.hidden_weight", memory.hidden_weight, (None, gates))
    _check_shape("memory.hidden_bias", memory.hidden_bias, (gates,))
    _check_shape("memory.input_weight", memory.input_weight, (inputs, gates))
    _check_shape("memory.input_bias", memory.input_bias, (gates,))


def _check_shape(name: str, array: np.ndarray, allowed: tuple[int | None, ...]) -> None:
    sizes = zip(array.shape, allowed, strict=False)
    if array.ndim != len(allowed) or not all(size and wanted in (None, size) for size, wanted in sizes):
        wanted = " × ".join("any" if size is None else str(size) for size in allowed)
        raise PolicyError(f"{name} has the shape {array.shape}; allowed: {wanted}")


def _tensors(policy: Policy) -> dict[str, np.ndarray]:
    memory = (
        {}
        if policy.memory is None
        else {_MEMORY_TENSORS[name]: array for name, array in vars(policy.memory).items()}
    )
    return {
        "observation.mean": policy.observation_mean,
        "observation.variance": policy.observation_variance,
        "observation.clip": np.array([policy.observation_clip], np.float64),
        "observation.epsilon": np.array([policy.observation_epsilon], np.float64),
        _ACTION_STD: np.array([policy.action_std], np.float64),
        **memory,
        **({} if policy.vision is None else policy.vision.to_tensors()),
        **{f"actor.{layer}.weight": weight for layer, weight in enumerate(policy.weights)},
        **{f"actor.{layer}.bias": bias for layer, bias in enumerate(policy.biases)},
    }


def _narrowed(array: np.ndarray) -> np.ndarray:
    """Returns the array in single precision if the conversion is exact, otherwise the array itself."""
    with np.errstate(over="ignore"):
        single = array.astype(np.float32)
    return single if (single == array).all() else array


def _read(file: Any) -> Policy:
    version, metadata = _read_metadata(file.metadata() or {})
    names = set(file.keys())
    others = {
        RECURRENT_FORMAT_VERSION: tuple(_MEMORY_TENSORS.values()),
        VISUAL_FORMAT_VERSION: VISION_TENSOR_NAMES,
    }
    fixed = (*_FIXED_TENSORS, *others.get(version, ()))
    layers = (len(names) - len(fixed)) // 2
    weights = [f"actor.{layer}.weight" for layer in range(layers)]
    biases = [f"actor.{layer}.bias" for layer in range(layers)]
    _check_names(names, {*weights, *biases}, fixed)
    mean, variance, clip, epsilon, deviation = (_tensor(file, name) for name in _FIXED_TENSORS)
    _check_shape("observation.clip", clip, (1,))
    _check_shape("observation.epsilon", epsilon, (1,))
    _check_shape(_ACTION_STD, deviation, (1,))
    return Policy(
        weights=tuple(_tensor(file, name) for name in weights),
        biases=tuple(_tensor(file, name) for name in biases),
        observation_mean=mean,
        observation_variance=variance,
        observation_clip=float(clip[0]),
        observation_epsilon=float(epsilon[0]),
        action_std=float(deviation[0]),
        metadata=metadata,
        memory=GatedRecurrentUnit(
            **{name: _tensor(file, of_file) for name, of_file in _MEMORY_TENSORS.items()}
        )
        if version == RECURRENT_FORMAT_VERSION
        else None,
        vision=VisionNetwork.from_tensors({name: _tensor(file, name) for name in VISION_TENSOR_NAMES})
        if version == VISUAL_FORMAT_VERSION
        else None,
    )


def _check_names(names: set[str], layers: set[str], fixed: tuple[str, ...]) -> None:
    allowed = layers | {*fixed}
    if names != allowed:
        raise PolicyError(
            f"tensors {sorted(names - allowed)} are not allowed and {sorted(allowed - names)} are missing; "
            f"allowed: {', '.join(fixed)}, and actor.0.weight, actor.0.bias, "
            "actor.1.weight and so on"
        )


def _tensor(file: Any, name: str) -> np.ndarray:
    dtype = file.get_slice(name).get_dtype()
    if dtype not in _DTYPES:
        raise PolicyError(f"{name} has the type {dtype}; allowed: {' and '.join(_DTYPES)}")
    return file.get_tensor(name)


class _Version(msgspec.Struct):
    format_version: int


class _Header(PolicyMetadata, frozen=True, kw_only=True):
    format_version: int


def _read_metadata(header: dict[str, str]) -> tuple[int, PolicyMetadata]:
    """Returns the format version and the metadata from the header of a policy file."""
    if _HEADER not in header:
        raise PolicyError(
            f"the file is not a policy of AVR Gym: its header has no entry {_HEADER!r}, only {sorted(header)}; "
            "allowed: files from `avrgym train`"
        )
    try:
        version = msgspec.json.decode(header[_HEADER], type=_Version).format_version
        versions = FEEDFORWARD_FORMAT_VERSION, RECURRENT_FORMAT_VERSION, VISUAL_FORMAT_VERSION
        if version not in versions:
            raise PolicyError(
                f"the file has format version {version}; allowed: {', '.join(map(str, versions))}. Install the AVR Gym "
                "version that wrote it"
            )
        described = msgspec.structs.asdict(msgspec.json.decode(header[_HEADER], type=_Header))
    except msgspec.DecodeError as error:
        raise PolicyError(
            f"{_HEADER!r} in the header is invalid: {error}; allowed: files from `avrgym train`"
        ) from error
    return described.pop("format_version"), PolicyMetadata(**described)
