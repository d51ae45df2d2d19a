"""Installs the example package and a broken package, and runs commands with both."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

from avrgym.study.storage.store import create_study
from helpers.system.paths import ROOT

FEW_EPISODES = "from avrgym.learning import training; training.EVALUATION_EPISODES = 2; "
COMMANDS = """
import json
import sys
from avrgym.cli import app

for command in json.loads(sys.argv[1]):
    assert not app(command, standalone_mode=False), command
"""


def install(folder: Path) -> None:
    """Install the example package and a broken package into a folder."""
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
    ]
    subprocess.run([*command, "--target", folder, ROOT / "examples" / "extension"], check=True, timeout=300)
    about = folder / "unfinished-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: unfinished\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "".join(
            f"[avrgym.{kind}]\nunfinished = unfinished:MISSING\n"
            for kind in ("tasks", "robots", "controllers")
        )
    )


def environment_variables(folder: Path) -> dict[str, str]:
    """Return environment variables with which processes find the packages of a folder."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(folder)])}


def python(folder: Path, *arguments: str) -> str:
    """Run Python in a folder with its packages, and return the output. The process must succeed."""
    ran = subprocess.run(
        [sys.executable, *arguments],
        env=environment_variables(folder),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=600,
        check=False,
    )
    assert ran.returncode == 0, ran.stdout
    return ran.stdout


def avrgym(folder: Path, *arguments: str) -> str:
    """Run an `avrgym` command with the packages of a folder, and return the output."""
    return python(folder, "-c", "from avrgym.cli import app; app()", *arguments)


def train_and_study(
    folder: Path,
    task: str,
    robot: str,
    term: str,
    steps: int,
    *,
    policies: tuple[str, ...],
    little: bool = False,
) -> None:
    """Train a policy, simulate a study, and check its report and a replayed recording, by commands.

    The study compares the trained policy with ``policies``. With ``little`` the training uses few worlds and episodes.
    """
    environment = f"avrgym/{task}{robot}-v1"
    (folder / "settings.toml").write_text("worlds = 4\nminibatch = 200\n" if little else "")
    policy = "run/policy.safetensors"
    _commands(
        folder,
        ["train", environment, "--steps", str(steps), "--config", "settings.toml", "--out", "run"],
        ["evaluate", environment, "--policy", policy, "--episodes", "2", "--json", "rows.json"],
        first=FEW_EPISODES if little else "",
    )
    (row,) = json.loads((folder / "rows.json").read_text())
    print(f"\n{environment} after {steps} steps: {row}")
    design = create_study(folder / "study")
    _set(
        design,
        tasks=[task],
        robots=[robot],
        policies=["mine", *policies],
        practice_policy="mine",
        trial_steps=20,
        free_movement_s=0.5,
    )
    (folder / "study" / "mine").mkdir()
    (folder / policy).rename(folder / "study" / "mine" / f"{task}{robot}.safetensors")
    _commands(
        folder,
        ["study", "simulate", "study", "--participants", "1", "--seed", "1"],
        ["analyze", "study", "--out", "report"],
    )
    assert term in (folder / "report" / "tables" / "reward_terms.csv").read_text()
    recording = next((folder / "study" / "recordings").rglob("*.mcap"))
    avrgym(folder, "replay", str(recording), "--verify")


def _commands(folder: Path, *commands: list[str], first: str = "") -> None:
    """Run commands in one process."""
    python(folder, "-c", first + COMMANDS, json.dumps(commands))


def _set(design: Path, **values: object) -> None:
    text = design.read_text()
    for name, value in values.items():
        text, found = re.subn(f"^{name} = .*$", f"{name} = {json.dumps(value)}", text, flags=re.M)
        assert found == 1, name
    design.write_text(text)
