"""Locks between processes. The kernel releases them when a process ends, even if it is killed."""

import fcntl
import os
import time
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from avrgym.system.files import open_privately

LOCK_FILE = "training.lock"
"""Name of the locked file. The file is never removed. It contains the id of the last process that locked it."""
RETRY_INTERVAL_S = 0.1


@contextmanager
def lock_folder(folder: Path, name: str = LOCK_FILE) -> Generator[None]:
    """Context manager: lock a folder. ``name``: name of the locked file.

    Raises:
        ValueError: if another process has locked the folder, or if its file system does not support locks.
        OSError: if the folder cannot be written.
    """
    with open(folder / name, "a+", opener=open_privately) as file:
        _lock(file, folder)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield


@contextmanager
def lock_number_in_file(path: Path, number: int, wait_s: float) -> Generator[None]:
    """Context manager: lock a number in the file ``path``. A missing file is created.

    ``wait_s``: maximum time in seconds to wait for another process. After this time, raises ``TimeoutError``.
    """
    ends_s = time.monotonic() + wait_s
    with open(path, "a", opener=open_privately) as file:
        while True:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, number)
                break
            except (BlockingIOError, PermissionError):
                if time.monotonic() > ends_s:
                    raise TimeoutError(
                        f"another process has locked number {number} in {path}; wait for it, then try again"
                    ) from None
                time.sleep(RETRY_INTERVAL_S)
        yield


def _lock(file: IO[str], folder: Path) -> None:
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        file.seek(0)
        holder = file.read(20).strip()
        by = f" by process {holder}" if holder.isdigit() else ""
        raise ValueError(
            f"{folder} is in use{by}; only one process at a time can use a folder. Wait, or choose another folder"
        ) from None
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be locked ({error.strerror}); choose a folder on a file system with locks"
        ) from error
