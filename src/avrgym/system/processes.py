"""Other processes of this machine."""

import os
from pathlib import Path


def is_running(process: int) -> bool:
    """Whether a process of this machine runs; where that cannot be known, it does.

    One that has ended but that its parent has not asked about is still there, as a zombie where Linux shows it.
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
