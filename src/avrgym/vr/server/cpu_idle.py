"""Keeping the processors of a virtual machine from halting while somebody is moved.

An idle processor halts and thereby falls to the host, which gives it back when it pleases, often milliseconds late.
Linux lets idle processors poll instead while its file of latencies is held open with a zero in it (its documentation:
"PM Quality of Service Interface" and "Guest halt polling"). Other machines wake within microseconds, and halting saves
their power.
"""

import struct
from pathlib import Path
from typing import BinaryIO

LATENCY_FILE = Path("/dev/cpu_dma_latency")
DRIVER_FILE = Path("/sys/devices/system/cpu/cpuidle/current_driver")
GUEST_IDLE_DRIVER = "haltpoll"
"""What looks after the idle processors of a virtual machine that can do so."""
ZERO_LATENCY = struct.pack("i", 0)


class CpuIdlePrevention:
    """Holds processors awake or lets them halt; where the system cannot or this user may not, it does nothing."""

    def __init__(self) -> None:
        self._file: BinaryIO | None = None
        self._possible = DRIVER_FILE.exists() and DRIVER_FILE.read_text().strip() == GUEST_IDLE_DRIVER

    def set(self, awake: bool) -> None:
        """Hold the processors awake from now on, or no longer."""
        if awake and self._file is None and self._possible:
            self._file = _open_latency_file()
            self._possible = self._file is not None
        elif not awake and self._file is not None:
            self._file.close()
            self._file = None


def _open_latency_file() -> BinaryIO | None:
    """The open file that keeps processors awake, or ``None`` for users who may not."""
    try:
        file = LATENCY_FILE.open("wb", buffering=0)
        file.write(ZERO_LATENCY)
    except OSError:
        return None
    return file
