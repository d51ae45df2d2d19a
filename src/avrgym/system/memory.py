"""How much memory there is, and what a process does with what it no longer uses."""

import ctypes
import os
import platform
from functools import cache

LARGE_BYTES = 4 << 20
"""A world's arena is 12 MiB and more; what a step computes with is less."""
_M_MMAP_THRESHOLD = -3
"""glibc's number of that setting: `mallopt(3)`."""


@cache
def return_large_blocks() -> None:
    """Have every block of 4 MiB or more go back to the system when it is freed; done once for the process.

    Left alone, glibc keeps blocks of up to 32 MiB for later use as soon as one was freed. Worlds that are made one
    after another then lie at other places, and the pages that they touched add up: 100 MiB more after 140 trials of
    a session. Other C libraries need no such word.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)


def available_bytes() -> int | None:
    """How much memory the system could give now; ``None`` where it does not say."""
    return _pages("SC_AVPHYS_PAGES")


def memory_bytes() -> int | None:
    """How much memory this computer has; ``None`` where it does not say."""
    return _pages("SC_PHYS_PAGES")


def _pages(name: str) -> int | None:
    try:
        return os.sysconf(name) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None
