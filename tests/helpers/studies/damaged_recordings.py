"""Damaged recordings, and the damages that an export does not detect."""

from pathlib import Path

import numpy as np

from avrgym.study.export.exported_attempts import list_completed_attempts, verify_attempts
from avrgym.study.storage.store import StudyStore

RECORDING = "recordings/sub-001/ses-01/trial-02_attempt-1.mcap"


def damaged_copies(content: bytes, count: int, rng: np.random.Generator) -> list[bytes]:
    """Return damaged copies of a file: half of them truncated, half with one flipped bit."""
    made = [content[:size] for size in rng.choice(len(content), count // 2, replace=False)]
    for place in rng.choice(len(content), count - count // 2, replace=False):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        made.append(bytes(damaged))
    return made


def count_undetected(folder: Path, count: int) -> int:
    """Count how many of ``count`` damages to a recording an export does not detect."""
    path = folder / RECORDING
    content = path.read_bytes()
    unnoticed = 0
    with StudyStore(folder) as store:
        (exported,) = (each for each in list_completed_attempts(store) if each.attempt.recording == RECORDING)
        for damaged in damaged_copies(content, count, np.random.default_rng(4)):
            path.write_bytes(damaged)
            unnoticed += not verify_attempts([exported])[1]
        path.write_bytes(content)
        assert verify_attempts([exported])[1] == []
    return unnoticed
