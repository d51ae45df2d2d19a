"""The client's body solver gives the same angles as the server's, shown by the same examples."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from helpers.vr import body_examples

CLIENT = Path(__file__).parents[2] / "client"
VITEST = CLIENT / "node_modules/vitest/vitest.mjs"
COUNT = 10_000


def test_the_clients_examples_equal_the_servers_solutions() -> None:
    kept = json.loads(body_examples.FILE.read_text("utf-8"))
    solved = list(body_examples.examples(np.random.default_rng(body_examples.SEED), body_examples.COUNT))
    assert len(kept) == len(solved)
    for one, other in zip(kept, solved, strict=True):
        np.testing.assert_allclose(one["angles"], other["angles"], atol=1e-9)
        assert list(one["skeleton"]) == list(other["skeleton"])
        for measure, length in one["skeleton"].items():
            assert length == pytest.approx(other["skeleton"][measure])


@pytest.mark.slow
def test_the_client_finds_the_same_angles_for_ten_thousand_poses(tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None or not VITEST.exists():
        pytest.skip("Node.js and the client's packages are needed: make setup")
    path = tmp_path / "bodies.json"
    body_examples.write(path, 0, COUNT)
    run = subprocess.run(
        [node, str(VITEST), "run", "--test-timeout=0", "tests/body/body-solver.test.ts"],
        cwd=CLIENT,
        env=os.environ | {"VITE_BODIES": str(path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert f"{COUNT} poses" in run.stdout
