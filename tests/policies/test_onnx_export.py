"""Trained policies written as ONNX files."""

from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from typer.testing import CliRunner

from avrgym.cli import app
from avrgym.policies.onnx import make_onnx_model
from avrgym.policies.registry import resolve_policy
from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.tasks.constants import PAPER_ENVIRONMENTS

ENVIRONMENT = "avrgym/FeedingJaco-v1"


@pytest.mark.parametrize("environment", PAPER_ENVIRONMENTS)
def test_onnx_export_of_every_policy_without_memory_acts_equally(environment: str) -> None:
    found = [resolve_policy(name, environment) for name in find_packaged_policies(environment)]
    without = [policy for policy in found if isinstance(policy, Policy) and policy.memory is None]
    assert len(without) == 2
    for policy in without:
        session = onnxruntime.InferenceSession(
            make_onnx_model(policy).SerializeToString(), providers=["CPUExecutionProvider"]
        )
        spread = np.sqrt(policy.observation_variance)
        seen = np.random.default_rng(0).normal(
            policy.observation_mean, 3.0 * spread, (200, policy.observation_size)
        )
        (actions,) = session.run(None, {"observation": seen})
        np.testing.assert_allclose(
            actions, np.clip(policy.compute_mean_actions(seen), -1, 1), rtol=0, atol=1e-6
        )


def test_the_command_writes_metadata_and_never_overwrites(tmp_path: Path) -> None:
    out = tmp_path / "feeding.onnx"
    command = ["export", "policy", "revised", ENVIRONMENT, str(out)]
    assert CliRunner().invoke(app, command).exit_code == 0
    model = onnx.load(out)
    about = {entry.key: entry.value for entry in model.metadata_props}
    assert (about["environment"], about["people"]) == (ENVIRONMENT, "revised")
    before = out.read_bytes()
    again = CliRunner().invoke(app, command)
    assert again.exit_code != 0
    assert "already exists; choose another name" in again.output
    assert out.read_bytes() == before


@pytest.mark.parametrize(
    ("policy", "out", "words"),
    [
        (
            "oracle",
            "a.onnx",
            "oracle is not a trained policy; allowed: original, revised or a .safetensors file",
        ),
        ("revised", "a.pt", "choose a name such as policy.onnx"),
    ],
    ids=["oracle", "ending"],
)
def test_policies_that_cannot_be_exported_are_refused(
    tmp_path: Path, policy: str, out: str, words: str
) -> None:
    result = CliRunner().invoke(app, ["export", "policy", policy, ENVIRONMENT, str(tmp_path / out)])
    assert result.exit_code != 0
    assert words in " ".join(result.output.split())
    assert not list(tmp_path.iterdir())
