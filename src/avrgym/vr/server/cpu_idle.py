"""Prevents idle states of a virtual machine's processors while the robot moves.

An idle virtual processor halts and returns control to the host. The host often resumes it some milliseconds late. On
Linux, a process can write zero to ``/dev/cpu_dma_latency``. While this file is open, idle processors poll instead of
halting (kernel documentation: "PM Quality of Service Interface", "Guest halt polling"). Physical machines wake within
microseconds and need no change.
"""

import struct
from pathlib import Path
from typing import BinaryIO

CPU_LATENCY_FILE = Path("/dev/cpu_dma_latency")
CPU_IDLE_DRIVER_FILE = Path("/sys/devices/system/cpu/cpuidle/current_driver")
GUEST_IDLE_DRIVER = "haltpoll"
"""Name of the idle driver in virtual machines that support polling."""
ZERO_LATENCY = struct.pack("i", 0)


class CpuIdlePrevention:
    """Prevents or permits idle states of the processors. Does nothing if the system lacks support or denies
    permission."""

    def __init__(self) -> None:
        self._file: BinaryIO | None = None
        self._possible = (
            CPU_IDLE_DRIVER_FILE.exists() and CPU_IDLE_DRIVER_FILE.read_text().strip() == GUEST_IDLE_DRIVER
        )

    def set_enabled(self, awake: bool) -> None:
        """Prevent idle states if ``awake`` is true; otherwise permit them."""
        if awake and self._file is None and self._possible:
            self._file = _open_latency_file()
            self._possible = self._file is not None
        elif not awake and self._file is not None:
            self._file.close()
            self._file = None


def _open_latency_file() -> BinaryIO | None:
    """Returns the open file that prevents idle states; ``None`` without permission."""
    try:
        file = CPU_LATENCY_FILE.open("wb", buffering=0)
        file.write(ZERO_LATENCY)
    except OSError:
        return None
    return file
