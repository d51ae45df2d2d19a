"""What stays out where it is not needed: `import avrgym` and `avrgym --help` wait for no heavy package."""

import subprocess
import sys

import pytest

LIBRARIES = {
    "PIL", "alembic", "av", "cryptography", "fastapi", "h5py", "matplotlib", "mcap", "msgspec", "onnxruntime", "pandas",
    "playwright", "pyarrow", "pydantic", "rich", "safetensors", "scipy", "segno", "sqlalchemy", "stable_baselines3",
    "tensorboard", "tomlkit", "torch", "trimesh", "uvicorn", "websockets",
}  # fmt: skip
OURS = {
    "avrgym.analysis", "avrgym.demo", "avrgym.doctor", "avrgym.envs.rendering", "avrgym.envs.single",
    "avrgym.envs.vector", "avrgym.learning", "avrgym.models.human_shape", "avrgym.people.files",
    "avrgym.policies.registry", "avrgym.recording", "avrgym.replay", "avrgym.skeletons", "avrgym.study.storage.store",
    "avrgym.tasks.episodes", "avrgym.vr.server.server",
}  # fmt: skip
HELP = """
import sys
from avrgym.cli import app

sys.argv = ["avrgym", "--help"]
try:
    app()
except SystemExit:
    pass
"""


@pytest.mark.parametrize("program", ["import sys, avrgym", HELP], ids=["import avrgym", "avrgym --help"])
def test_nothing_heavy_is_imported(program: str) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", f"{program}\nprint('modules', *sys.modules)"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    imported = set(ran.stdout.split("modules", 1)[1].split())
    assert {"avrgym.tasks.registry", "mujoco", "gymnasium"} <= imported
    assert sorted(imported & (LIBRARIES | OURS)) == []
