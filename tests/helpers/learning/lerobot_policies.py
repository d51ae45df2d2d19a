"""LeRobot policies for tests: a small ACT, and a program that answers like the worker process."""

import json
import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from avrgym.policies.lerobot import LEROBOT_PYTHON_VARIABLE

MAKE_ACT = """
import json, sys
import torch
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.factory import get_policy_class, make_pre_post_processors

folder, features, options = sys.argv[1], json.loads(sys.argv[2]), json.loads(sys.argv[3])
kinds = {"action": FeatureType.ACTION, "observation.state": FeatureType.STATE}
kinds["observation.environment_state"] = FeatureType.ENV
found = {name: PolicyFeature(kinds.get(name, FeatureType.VISUAL), tuple(shape)) for name, shape in features.items()}
torch.manual_seed(0)
config = ACTConfig(
    input_features={name: each for name, each in found.items() if name != "action"},
    output_features={"action": found["action"]},
    device="cpu", dim_model=32, n_heads=2, dim_feedforward=32, n_encoder_layers=1, n_decoder_layers=1,
    chunk_size=4, pretrained_backbone_weights=None, push_to_hub=False, **options,
)
policy = get_policy_class("act")(config)
stats = {
    name: {"mean": torch.zeros(each.shape), "std": torch.ones(each.shape)}
    if len(each.shape) == 1 else {"mean": torch.zeros(3, 1, 1), "std": torch.ones(3, 1, 1)}
    for name, each in found.items()
}
policy.save_pretrained(folder)
for pipeline in make_pre_post_processors(config, dataset_stats=stats):
    pipeline.save_pretrained(folder)
"""
"""Program that writes an untrained ACT. Arguments: folder, shapes of the features, other settings."""

STUB = """
import json, sys
count = {}
print(json.dumps({"ready": True}), flush=True)
for line in sys.stdin:
    request = json.loads(line)
    session = request["session"]
    if "seed" in request:
        count[session] = request["seed"]
        answer = {"reset": True}
    elif "end" in request:
        del count[session]
        answer = {"ended": True}
    elif session not in count:
        answer = {"error": "KeyError: no such\\nsession"}
    elif request["observation.state"][0] < 0.0:
        sys.stderr.write("Segmentation fault\\n")
        sys.exit(1)
    else:
        count[session] += 1
        answer = {"action": [count[session], *request["observation.state"]], "task": request["task"]}
    print(json.dumps(answer), flush=True)
"""
"""Program with the worker's protocol. Its action contains the seed plus the number of steps, and the state."""


def lerobot_python() -> str | None:
    """The Python that has LeRobot, or None."""
    python = os.environ.get(LEROBOT_PYTHON_VARIABLE) or sys.executable
    return python if has_modules(python, "lerobot") else None


def has_modules(python: str, *names: str) -> bool:
    """Whether an environment of Python has all these modules."""
    code = "import importlib.util as u, sys; sys.exit(not all(map(u.find_spec, sys.argv[1:])))"
    return subprocess.run([python, "-c", code, *names], check=False).returncode == 0


def run_lerobot(python: str, code: str, arguments: Sequence[str]) -> str:
    """Run a program with LeRobot, offline. Returns its output."""
    environment = {**os.environ, "HF_HUB_OFFLINE": "1"}
    run = subprocess.run(
        [python, "-c", code, *arguments], env=environment, capture_output=True, text=True, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def save_act(python: str, folder: Path, features: Mapping[str, Sequence[int]], **options: Any) -> Path:
    """Write an untrained ACT with these features. Returns its folder."""
    run_lerobot(python, MAKE_ACT, [str(folder), json.dumps(features), json.dumps(options)])
    return folder


def save_configuration(folder: Path, features: Mapping[str, Sequence[int]]) -> Path:
    """Write the files of a policy that the loader reads before its process starts. Returns the folder."""
    folder.mkdir(exist_ok=True)
    shapes = {name: {"shape": [*shape]} for name, shape in features.items()}
    outputs = {name: shapes.pop(name) for name in [*shapes] if name == "action"}
    configuration = {"input_features": shapes, "output_features": outputs}
    (folder / "config.json").write_text(json.dumps(configuration))
    (folder / "model.safetensors").write_bytes(b"weights")
    return folder
