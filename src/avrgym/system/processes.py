"""Checks whether other processes of this computer are running."""

import os
from pathlib import Path


def is_process_running(process: int) -> bool:
    """Returns whether a process with this id is running; ``True`` if this cannot be determined.

    On Linux, returns ``False`` for a zombie process.
    """
    if os.name != "posix":
        return True
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True
    return state not in ("Z", "X")
