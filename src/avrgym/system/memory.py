"""What a process does with memory that it no longer uses."""

import ctypes
import platform
from functools import cache

LARGE_BYTES = 1 << 20
_M_MMAP_THRESHOLD = -3
"""glibc's number of that setting: `mallopt(3)`."""


@cache
def return_large_blocks() -> None:
    """Have every block of a megabyte or more go back to the system when it is freed; done once for the process.

    Left alone, glibc keeps blocks of up to 32 MiB for later use as soon as one was freed. A world's arrays then lie at
    another place in each trial, and their pages add up: after 240 trials 175 MiB. Other libraries need no such word.
    """
    if platform.libc_ver()[0] == "glibc":
        ctypes.CDLL(None).mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
