"""Size of the computer's memory, and a setting that returns freed memory to the system."""

import ctypes
import os
import platform
from functools import cache

MMAP_THRESHOLD_BYTES = 4 << 20
"""Freed memory blocks of this size or more are returned to the system. The memory arenas of worlds are larger; the
arrays of a control step are smaller.
"""
_M_MMAP_THRESHOLD = -3
"""Number of the parameter for the mmap threshold in glibc, see `mallopt(3)`."""


@cache
def set_mmap_threshold() -> None:
    """Configure glibc to return freed blocks of 4 MiB or more to the system. Only the first call has an effect.

    By default, glibc may not return freed blocks of up to 32 MiB. The memory of a session would then grow from trial to
    trial. Other C libraries do not need this setting.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES)


def get_available_memory_bytes() -> int | None:
    """Returns the free memory of this computer in bytes; ``None`` if the system does not report it."""
    return _pages("SC_AVPHYS_PAGES")


def get_total_memory_bytes() -> int | None:
    """Returns the total memory of this computer in bytes; ``None`` if the system does not report it."""
    return _pages("SC_PHYS_PAGES")


def _pages(name: str) -> int | None:
    try:
        return os.sysconf(name) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
