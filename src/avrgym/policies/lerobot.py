"""Pretrained policies of LeRobot as controllers: ``--policy lerobot:FOLDER``.

The policy runs in a separate process, see ``lerobot_worker``. LeRobot chooses the rate of the network: its
``select_action`` returns an action in every control step, from a chunk of actions or from their temporal ensemble.
"""

import atexit
import base64
import itertools
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import ArrayLike

from avrgym.array_types import NumpyArray
from avrgym.models.cameras import STATE_ENTRY, AnyObservation, CameraSpec
from avrgym.policies.controllers import ControllerError, ExternalController
from avrgym.policies.trained_policies import PolicyError
from avrgym.system.type_guards import is_table
from avrgym.system.used_plugins import UsedPlugin, compute_files_sha256
from avrgym.tasks.observation import ObservationSpec, make_robot_measured_mask

LEROBOT_POLICY_PREFIX = "lerobot:"
LEROBOT_PYTHON_VARIABLE = "AVRGYM_LEROBOT_PYTHON"
"""Environment variable with the path of the Python that has LeRobot. By default, the Python of AVR Gym is used."""
STATE_FEATURE, ENVIRONMENT_STATE_FEATURE, IMAGE_FEATURE_PREFIX = (
    "observation.state",
    "observation.environment_state",
    "observation.images.",
)
"""Names of the features in LeRobot: values that the robot measures itself, other values, and the prefix of images."""
LOADING_TIMEOUT_S, ANSWER_TIMEOUT_S = 300.0, 10.0
CONFIGURATION_FILE, WEIGHTS_FILE = "config.json", "model.safetensors"


def split_state_features(observation: ObservationSpec, values: NumpyArray) -> dict[str, NumpyArray]:
    """Splits observations (..., O) into LeRobot's features. Returns the values of each feature, by name.

    ``STATE_FEATURE`` contains the entries that the robot measures itself, ``ENVIRONMENT_STATE_FEATURE`` all other
    entries. Both have the order of the observation.
    """
    measured = make_robot_measured_mask(observation)
    parts = {STATE_FEATURE: values[..., measured], ENVIRONMENT_STATE_FEATURE: values[..., ~measured]}
    return {name: part for name, part in parts.items() if part.shape[-1]}


def is_lerobot_policy(name: str) -> bool:
    """Returns whether the name of a policy has the form ``lerobot:FOLDER``."""
    return name.startswith(LEROBOT_POLICY_PREFIX)


def find_weights_file(name: str) -> Path:
    """Returns the path of the weights of the policy ``lerobot:FOLDER``.

    Raises:
        PolicyError: if the file is missing.
    """
    file = Path(name.removeprefix(LEROBOT_POLICY_PREFIX)) / WEIGHTS_FILE
    if not file.is_file():
        raise PolicyError(
            f"{name}: the file {WEIGHTS_FILE} is missing; copy the whole folder pretrained_model"
        )
    return file


def make_lerobot_plugin(name: str) -> UsedPlugin:
    """Returns the policy ``lerobot:FOLDER`` as a used plug-in with the hash of its files. If the files are missing, the
    hash is empty.
    """
    files = [
        *Path(name.removeprefix(LEROBOT_POLICY_PREFIX)).glob("*.json"),
        *Path(name.removeprefix(LEROBOT_POLICY_PREFIX)).glob("*.safetensors"),
    ]
    sha256 = compute_files_sha256((path.name, path) for path in files) if files else ""
    return UsedPlugin("controller", name, name, sha256=sha256)


def load_lerobot_controller(
    name: str, observation: ObservationSpec, action_size: int, instruction: str
) -> ExternalController:
    """Returns the policy ``lerobot:FOLDER`` as a controller. The process of the policy starts with the first instance.

    Args:
        name: ``lerobot:`` and a folder ``pretrained_model`` of ``lerobot-train``.
        observation: the environment's observation.
        action_size: the length of the environment's actions.
        instruction: description of the task in words, an input of language-conditioned policies.

    Raises:
        PolicyError: if the folder contains no policy, or a policy with other inputs or another output.
    """
    folder = Path(name.removeprefix(LEROBOT_POLICY_PREFIX))
    inputs, outputs = _features(name, folder)
    sizes = {
        feature: part.shape[-1]
        for feature, part in split_state_features(observation, np.zeros(observation.size)).items()
    }
    cameras: list[CameraSpec] = []
    for feature, shape in inputs.items():
        if feature.startswith(IMAGE_FEATURE_PREFIX) and feature.endswith("_rgb") and len(shape) == 3:
            try:
                cameras.append(
                    CameraSpec(feature.removeprefix(IMAGE_FEATURE_PREFIX)[: -len("_rgb")], shape[2], shape[1])
                )
            except ValueError as error:
                raise PolicyError(f"{name}: {error}") from error
        elif shape != [sizes.get(feature)]:
            allowed = ", ".join([f"{each} [{size}]" for each, size in sizes.items()])
            raise PolicyError(
                f"{name}: the policy's input is {feature} {shape}; allowed: {allowed}, "
                f"{IMAGE_FEATURE_PREFIX}CAMERA_rgb "
                "[3, HEIGHT, WIDTH]; train it with a dataset of this environment"
            )
    if outputs != {"action": [action_size]}:
        raise PolicyError(f"{name}: the policy's outputs are {outputs}; allowed: action [{action_size}]")
    features = [feature for feature in inputs if feature in sizes]
    return ExternalController(
        name,
        lambda: LeRobotController(_process(str(folder.resolve())), observation, features, instruction),
        make_lerobot_plugin(name),
        tuple(cameras),
        prepare=lambda: _process(str(folder.resolve())).start(),
    )


def _features(name: str, folder: Path) -> tuple[dict[str, list[int]], dict[str, list[int]]]:
    """Returns the shapes of a policy's inputs and outputs, by their names in LeRobot."""
    try:
        configuration = json.loads((folder / CONFIGURATION_FILE).read_bytes())
        shapes = [
            {feature: [*about["shape"]] for feature, about in configuration[key].items()}
            for key in ("input_features", "output_features")
        ]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise PolicyError(
            f"{name}: the folder contains no LeRobot policy ({type(error).__name__}: {error}); allowed: a folder "
            "pretrained_model of lerobot-train"
        ) from error
    find_weights_file(name)
    return shapes[0], shapes[1]


class LeRobotController:
    """A controller with a policy in another process. All controllers of a policy share the process."""

    _numbers = itertools.count()

    def __init__(
        self, process: "PolicyProcess", observation: ObservationSpec, features: list[str], instruction: str
    ) -> None:
        """Use the policy in ``process``. ``features``: names of its inputs that are not images."""
        self._process, self._observation, self._features = process, observation, features
        self._instruction, self._session = instruction, next(self._numbers)
        process.start()

    def reset(self, seed: int, environment: str) -> None:
        """Start an episode: clear the queue of actions. The seed determines the policy's noise."""
        self._process.send_request({"session": self._session, "seed": seed})

    def act(self, observation: AnyObservation) -> ArrayLike:
        """Returns the policy's action (A,) for an observation (O,), or for a dictionary with images.

        Raises:
            ControllerError: if the policy fails or its process has ended.
        """
        entries: Mapping[str, NumpyArray] = (
            observation if isinstance(observation, dict) else {STATE_ENTRY: observation}
        )
        states = split_state_features(self._observation, entries[STATE_ENTRY])
        features: dict[str, Any] = {name: states[name].tolist() for name in self._features}
        for name, image in entries.items():
            if name != STATE_ENTRY:
                data = base64.b64encode(image.tobytes()).decode()
                features[IMAGE_FEATURE_PREFIX + name] = {"shape": image.shape, "data": data}
        return self._process.send_request({"session": self._session, "task": self._instruction, **features})[
            "action"
        ]

    def close(self) -> None:
        """End the session of this controller. The process continues for other controllers, until this program ends."""
        with suppress(ControllerError):
            self._process.send_request({"session": self._session, "end": True})


class PolicyProcess:
    """The process that computes the actions of one LeRobot policy. It ends with this program."""

    def __init__(self, command: list[str], environment: Mapping[str, str]) -> None:
        """Store the command that starts the process. ``environment`` contains additional environment variables."""
        self._command, self._environment = command, environment
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        atexit.register(self.stop)

    @property
    def is_running(self) -> bool:
        """Whether the process of the policy is running."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start the process if it does not run, and wait until it has loaded the policy.

        Raises:
            PolicyError: if the policy cannot be loaded.
        """
        with self._lock:
            if self.is_running:
                return
            self._stop()
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 it is open as long as the process runs
            try:
                self._process = subprocess.Popen(
                    self._command,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._errors,
                    env={**os.environ, **self._environment},
                )
                self._answer(LOADING_TIMEOUT_S)
            except (OSError, ControllerError) as error:
                self._stop()
                raise PolicyError(
                    f"{self._command[-1]}: {error}; install LeRobot with `pip install 'avrgym[lerobot]'`, or set "
                    f"{LEROBOT_PYTHON_VARIABLE} to the Python of an environment that has it"
                ) from error

    def send_request(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Send a request to the process. Returns its answer.

        Raises:
            ControllerError: if the policy fails, does not answer, or its process has ended.
        """
        with self._lock:
            process = self._process
            if process is None or process.stdin is None:
                raise ControllerError("exception: the process of the LeRobot policy has ended")
            try:
                process.stdin.write(json.dumps(request).encode() + b"\n")
                process.stdin.flush()
            except OSError as error:
                raise self._crash() from error
            return self._answer(ANSWER_TIMEOUT_S)

    def stop(self) -> None:
        """End the process of the policy, if it is running."""
        with self._lock:
            self._stop()

    def _stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
        if self._errors is not None:
            self._errors.close()
        self._process = self._errors = None

    def _answer(self, timeout_s: float) -> dict[str, Any]:
        """Returns the next answer of the process. Ends the process if no answer arrives within ``timeout_s``."""
        process = self._process
        assert process is not None
        assert process.stdout is not None
        is_late = threading.Event()

        def kill() -> None:
            is_late.set()
            process.kill()

        timer = threading.Timer(timeout_s, kill)
        timer.start()
        line = process.stdout.readline()
        timer.cancel()
        if is_late.is_set():
            self._stop()
            raise ControllerError(f"late: no answer of the LeRobot policy within {timeout_s:.0f} s")
        try:
            answer: object = json.loads(line)
        except ValueError:
            answer = None
        if not is_table(answer):
            raise self._crash()
        if "error" in answer:
            raise ControllerError(f"exception: {' '.join(str(answer['error']).split())[:300]}")
        return dict(answer)

    def _crash(self) -> ControllerError:
        """Clean up after an unexpected end of the process. Returns an error with the last line of the process's
        messages.
        """
        reason = self._last_error()
        self._stop()
        return ControllerError(f"exception: the process has ended ({reason})")

    def _last_error(self) -> str:
        """Returns the last line that the process has written to standard error."""
        if self._errors is None:
            return "no error message"
        size = self._errors.seek(0, os.SEEK_END)
        self._errors.seek(max(0, size - 4096))
        lines = self._errors.read().decode(errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "no error message")


@cache
def _process(folder: str) -> PolicyProcess:
    """Returns the process of the policy in ``folder``. All controllers of this policy share the process."""
    python = os.environ.get(LEROBOT_PYTHON_VARIABLE) or sys.executable
    worker = Path(__file__).with_name("lerobot_worker.py")
    options = ["-P"]  # the module avrgym.policies.lerobot must not replace the package lerobot
    return PolicyProcess([python, *options, str(worker), folder], {"HF_HUB_OFFLINE": "1"})
