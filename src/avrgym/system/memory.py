"""What a process does with memory that it no longer uses."""

import ctypes
import os
import platform
import sys
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


def memory_bytes() -> int:
    """How much memory this computer has."""
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return sys.maxsize
