"""Only one process at a time uses a locked folder."""

import errno
import fcntl
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner

from avrgym.cli.main import app
from avrgym.system.locks import lock_folder
from helpers.system.paths import DATA
from helpers.system.processes import kill_with_parent

TRAINING = DATA / "training-of-0.2.0"
HOLD = """
import sys, time
from pathlib import Path
from avrgym.system.locks import lock_folder

with lock_folder(Path(sys.argv[1])):
    print(flush=True)
    time.sleep(600)
"""


@contextmanager
def held(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that uses a folder."""
    command = [sys.executable, "-c", HOLD, folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=kill_with_parent) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "\n"
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("arguments", [["--resume"], []])
def test_a_second_training_in_a_folder_is_refused(tmp_path: Path, arguments: list[str]) -> None:
    """It names folder and process, and leaves everything as it was."""
    pytest.importorskip("stable_baselines3", reason="training is an extra")
    folder = tmp_path / "run"
    shutil.copytree(TRAINING, folder)
    with held(folder) as process:
        before = {path.name: path.read_bytes() for path in folder.iterdir()}
        if not arguments:
            (folder / "configuration.json").unlink()
        refused = CliRunner().invoke(
            app, ["train", "avrgym/ScratchItchJaco-v1", "--out", str(folder), *arguments]
        )
        assert refused.exit_code == 1
        (line,) = refused.stderr.splitlines()
        assert line.startswith(f"avrgym: {folder} is in use by process {process.pid}; only one process")
        after = {path.name: path.read_bytes() for path in folder.iterdir()}
        assert after.items() <= before.items()


def test_a_folder_is_free_again_however_its_process_ended(tmp_path: Path) -> None:
    with held(tmp_path) as process:
        with pytest.raises(ValueError, match=f"in use by process {process.pid}"), lock_folder(tmp_path):
            pass
        process.send_signal(signal.SIGKILL)
        process.wait()
    with lock_folder(tmp_path):
        assert (tmp_path / "training.lock").read_text() == f"{os.getpid()}\n"
        with pytest.raises(ValueError, match=f"in use by process {os.getpid()}"), lock_folder(tmp_path):
            pass
    with lock_folder(tmp_path):
        pass


def test_a_file_system_without_locks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(*_: object) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", none)
    with (
        pytest.raises(ValueError, match=r"cannot be locked \(No locks available\); choose a folder on"),
        lock_folder(tmp_path),
    ):
        pass
