"""Studies with one flipped bit."""

import random
import shutil
from pathlib import Path

from avrgym.study.checking.study_checks import check_study
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore


def flip_bit(study: Path, copy: Path, rng: random.Random, name: str) -> int:
    """Copy a study and flip one bit of a file. Returns the position of the bit."""
    shutil.rmtree(copy, ignore_errors=True)
    shutil.copytree(study, copy)
    data = bytearray((copy / name).read_bytes())
    bit = rng.randrange(8 * len(data))
    data[bit // 8] ^= 1 << bit % 8
    (copy / name).write_bytes(data)
    return bit


def is_detected(study: Path) -> bool:
    """Return whether a study fails to open or its check finds an error."""
    try:
        with StudyStore(study) as store:
            return any(finding.is_error for finding in check_study(store))
    except StudyError:
        return True
