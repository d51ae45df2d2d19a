"""Program that runs a pretrained LeRobot policy, in a process next to the control loop.

It imports LeRobot, but not AVR Gym, because both may be installed in different environments of Python. Requests and
answers are JSON, one per line, on standard input and output. All other output goes to standard error.

| request | answer |
|---|---|
| none; sent when the policy is loaded | ``{"ready": true}`` |
| ``{"session": 1, "seed": 5}`` starts an episode | ``{"reset": true}`` |
| ``{"session": 1, "task": "…", "observation.state": […], …}`` | ``{"action": […]}`` |
| ``{"session": 1, "end": true}`` deletes the session | ``{"ended": true}`` |

An image is ``{"shape": [H, W, 3], "data": "…"}`` with 8-bit colours in base64. The answer to an invalid request is
``{"error": "…"}``.
"""

# LeRobot may be installed in another environment of Python.
# pyright: basic, reportMissingImports=false

import base64
import copy
import json
import os
import sys
from typing import Any

import numpy as np
import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

RandomGeneratorState = tuple[torch.Tensor, list[torch.Tensor]]
WARM_UP_SESSION_ID = -1


class PolicyServer:
    """A loaded policy with one copy per session. Copies share the weights, but not the queues of actions."""

    def __init__(self, folder: str) -> None:
        """Load the policy in ``folder``, and compute one action, because the first computation takes longest."""
        config: Any = PreTrainedConfig.from_pretrained(folder)
        if hasattr(config, "pretrained_backbone_weights"):
            config.pretrained_backbone_weights = (
                None  # they would be downloaded, then replaced by the folder's
            )
        self._policy = get_policy_class(config.type).from_pretrained(folder, config=config)
        device = {"device_processor": {"device": config.device}}
        self._preprocess, self._postprocess = make_pre_post_processors(
            config, folder, preprocessor_overrides=device
        )
        self._sessions: dict[int, tuple[Any, RandomGeneratorState]] = {}
        self.answer_request({"session": WARM_UP_SESSION_ID, "seed": 0})
        self.answer_request({"session": WARM_UP_SESSION_ID, "task": "", **_zeros(config.input_features)})
        self.answer_request({"session": WARM_UP_SESSION_ID, "end": True})

    def answer_request(self, request: dict[str, Any]) -> dict[str, Any]:
        """Returns the answer to a request; the table of this module lists both."""
        session = request.pop("session")
        if "seed" in request:
            self._start(session, request["seed"])
            return {"reset": True}
        if "end" in request:
            self._sessions.pop(session, None)
            return {"ended": True}
        return {"action": self._act(session, request)}

    def _start(self, session: int, seed: int) -> None:
        shared = {id(tensor): tensor for tensor in (*self._policy.parameters(), *self._policy.buffers())}
        policy = copy.deepcopy(self._policy, shared)
        policy.reset()
        torch.manual_seed(seed)
        self._sessions[session] = policy, _noise_state()

    def _act(self, session: int, request: dict[str, Any]) -> list[float]:
        policy, (noise, device_noise) = self._sessions[session]
        torch.set_rng_state(noise)
        torch.cuda.set_rng_state_all(device_noise)
        batch = {name: value if name == "task" else _tensor(value) for name, value in request.items()}
        with torch.inference_mode():
            action = self._postprocess(policy.select_action(self._preprocess(batch)))
        self._sessions[session] = policy, _noise_state()
        return action[0].tolist()


def _noise_state() -> RandomGeneratorState:
    """Returns the state of PyTorch's random generators. Each session has its own stream."""
    return torch.get_rng_state(), torch.cuda.get_rng_state_all() if torch.cuda.is_available() else []


def _tensor(value: Any) -> torch.Tensor:
    """Returns a feature as LeRobot's datasets contain it: numbers (O,), or an image (3, H, W) from 0 to 1."""
    if isinstance(value, list):
        return torch.tensor(value, dtype=torch.float32)
    image = np.frombuffer(base64.b64decode(value["data"]), np.uint8).reshape(value["shape"])
    return torch.from_numpy(image.copy()).permute(2, 0, 1).float() / 255.0


def _zeros(features: dict[str, Any]) -> dict[str, Any]:
    """Returns zeros for each input feature of a policy, as in a request."""
    found: dict[str, Any] = {}
    for name, feature in features.items():
        shape = tuple(feature.shape)
        image = {
            "shape": [*shape[1:], shape[0]],
            "data": base64.b64encode(bytes(int(np.prod(shape)))).decode(),
        }
        found[name] = [0.0] * shape[0] if len(shape) == 1 else image
    return found


def main() -> None:
    """Load the policy in the folder of the first argument, and answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what LeRobot prints must not mix with answers

    def send(answer: dict[str, Any]) -> None:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()

    torch.set_num_threads(1)  # the same sums, and thus bits, with any number of cores
    try:
        server = PolicyServer(sys.argv[1])
    except Exception as error:
        send({"error": f"the policy cannot be loaded ({type(error).__name__}: {error})"})
        return
    send({"ready": True})
    for line in sys.stdin:
        try:
            send(server.answer_request(json.loads(line)))
        except Exception as error:
            send({"error": f"{type(error).__name__}: {error}"})


if __name__ == "__main__":
    main()
