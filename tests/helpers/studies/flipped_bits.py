"""Studies with one flipped bit."""

import random
import shutil
from pathlib import Path

from avrgym.study.checking.checks import check_study
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store


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
        with Store(study) as store:
            return any(finding.is_error for finding in check_study(store))
    except StudyError:
        return True
