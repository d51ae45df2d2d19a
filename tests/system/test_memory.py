import platform
import subprocess
import sys

import pytest

HELD = """
import os
from pathlib import Path
import numpy as np
from avrgym.system.memory import MMAP_THRESHOLD_BYTES, set_mmap_threshold

def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")

set_mmap_threshold()
begun = resident_bytes()
large = MMAP_THRESHOLD_BYTES
blocks = [np.ones(large // 256 if number % 2 else large + 4096, np.uint8) for number in range(150)]
filled = resident_bytes() - begun
del blocks[::2]
print(filled, resident_bytes() - begun)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries are left as they are")
def test_freed_large_blocks_return_to_the_system() -> None:
    told = subprocess.run([sys.executable, "-c", HELD], capture_output=True, text=True, check=True).stdout
    filled, held = map(int, told.split())
    assert filled > 300 << 20
    assert held < filled / 4
