"""Folders that one process uses at a time."""

import fcntl
import os
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

LOCK_FILE = "training.lock"
"""Stays when it is free: the lock is the kernel's, the file only what it is held on. It holds the last process's id."""


@contextmanager
def locked(folder: Path) -> Generator[None]:
    """Use a folder alone until the end; it is free again when this process ends, however that ends.

    Raises:
        ValueError: where another process uses it, or its file system has no locks.
        OSError: where nothing can be written there.
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
        raise ValueError(f"{folder} is in use{by}: one training at a time goes on in a folder") from None
    except OSError as error:
        raise ValueError(
            f"{folder} cannot be locked ({error.strerror}); choose a folder on a file system with locks"
        ) from error
