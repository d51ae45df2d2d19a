"""Every example runs in an empty folder with small numbers and writes its files."""

import os
import runpy
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import matplotlib
import pytest

from helpers.learning.small_training import shorten_training
from helpers.system.paths import OLD_RECORDING, ROOT

EXAMPLES = ROOT / "examples"
RECORDING = OLD_RECORDING
RUNS: dict[str, tuple[list[str], list[str]]] = {
    "01_step_and_render": ([], ["feeding.png"]),
    "02_random_oracle_trained": (["1"], []),
    "03_train_and_plot": (["1"], ["trained/policy.safetensors", "learning.png"]),
    "04_many_worlds": (["2"], []),
    "05_own_person": ([], ["people.png", "tall.toml"]),
    "06_study": (["1", "3"], ["my-study/analysis/report/index.html"]),
    "07_recording_to_data_frame": ([str(RECORDING)], ["trial.png"]),
    "08_ppo_loop": (["1", "2"], []),
    "09_stable_baselines3": (["1", "2"], ["sb3.zip", "sb3.pkl"]),
    "10_rllib": (["2", "8", "0"], ["rllib.safetensors"]),
    "11_torchrl": (["1", "8"], []),
}
"""Arguments and output files of each example."""
MAX_LINES = 60
OPTIONAL = {"10_rllib": "ray.rllib", "11_torchrl": "torchrl"}
"""Optional packages: these examples run only if the package is installed."""


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    shorten_training(monkeypatch)
    matplotlib.use("agg")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of third-party libraries
        yield


def test_examples_are_short_tested_and_documented() -> None:
    files = sorted(EXAMPLES.glob("[0-9]*.py"))
    assert [file.stem for file in files] == list(RUNS)
    assert [file.name for file in files if len(file.read_text().splitlines()) >= MAX_LINES] == []
    for name in ("docs/examples.md", "examples/README.md"):
        page = (ROOT / name).read_text()
        assert [file.name for file in files if file.name not in page] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", RUNS)
def test_example_runs_and_writes_its_files(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if name in OPTIONAL:
        pytest.importorskip(OPTIONAL[name], reason="this example's package is not installed")
    arguments, written = RUNS[name]
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *arguments])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert [file for file in written if not os.path.getsize(file)] == []
