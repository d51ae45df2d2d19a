"""Builds and installs the wheel as an unprivileged user, in a folder with spaces and umlauts.

The installation then runs a simulated participant and a simulated study to their reports.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from helpers.system.paths import ROOT

DESIGN = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "policies": '["revised"]', "practice_policy": '""'}
UNPRIVILEGED_USER = 65534
"""User id of ``nobody``."""
PYTHON = "/usr/bin/python3" if os.geteuid() == 0 else sys.executable
"""An interpreter that this user can run."""


@pytest.fixture
def lab() -> Iterator[Path]:
    """A folder of an unprivileged user."""
    folder = Path(tempfile.mkdtemp(prefix="Lab für Ärzte "))
    if os.geteuid() == 0:
        os.chown(folder, UNPRIVILEGED_USER, UNPRIVILEGED_USER)
    yield folder
    shutil.rmtree(folder)


def run(lab: Path, *command: str | Path) -> str:
    """Run a command as an unprivileged user, and return its output."""
    user: dict[str, Any] = (
        {"user": UNPRIVILEGED_USER, "group": UNPRIVILEGED_USER} if os.geteuid() == 0 else {}
    )
    kept = {name: os.environ[name] for name in os.environ if name.startswith(("PIP_", "SSL_", "LANG"))}
    ran = subprocess.run(
        command,
        cwd=lab,
        env=kept | {"HOME": str(lab), "PATH": f"{lab / 'env' / 'bin'}:/usr/bin:/bin"},
        capture_output=True,
        text=True,
        **user,
    )
    assert ran.returncode == 0, (command, ran.stdout, ran.stderr)
    return ran.stdout


def test_a_wheel_in_an_empty_environment(lab: Path) -> None:
    build = f"import hatchling.build; print(hatchling.build.build_wheel({str(lab)!r}))"
    subprocess.run([sys.executable, "-c", build], cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    (wheel,) = lab.glob("*.whl")
    wheel.chmod(0o644)
    run(lab, PYTHON, "-m", "venv", "env")
    run(lab, "pip", "install", "--quiet", "--no-cache-dir", f"{wheel}[study]")
    assert "errors: 0" in run(lab, "avrgym", "doctor")
    assert "page      demo/FeedingJaco.html" in run(lab, "avrgym", "demo", "--out", "demo")
    assert (lab / "demo" / "FeedingJaco.html").stat().st_size > 100_000
    run(lab, "avrgym", "study", "new", "studie")
    design = lab / "studie" / "study.toml"
    lines = design.read_text().splitlines()
    for name, value in DESIGN.items():
        lines = [f"{name} = {value}" if line.startswith(f"{name} = ") else line for line in lines]
    design.write_text("\n".join(lines) + "\n")
    run(lab, "avrgym", "study", "simulate", "studie", "--participants", "2")
    run(lab, "avrgym", "analyze", "studie")
    assert "simulated" in (lab / "studie" / "analysis" / "report" / "index.html").read_text()
    python = run(lab, "python", "--version").strip()
    print(f"\n{wheel.name} on {python}, in {lab}: doctor, demo, study and its report, no fault")
