"""Lock a folder for one process at a time."""

import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

LOCK_FILE = "training.lock"
"""Name of the locked file. The file is never removed. It contains the id of the last process that locked it."""


@contextmanager
def lock_folder(folder: Path) -> Generator[None]:
    """Context manager: lock a folder. The kernel releases the lock when this process ends, even if it is killed.

    Raises:
        ValueError: if another process has locked the folder, or if its file system does not support locks.
        OSError: if the folder cannot be written.
    """
    with open(folder / LOCK_FILE, "a+") as file:
        _lock(file, folder)
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
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
