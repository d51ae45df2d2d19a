"""What earlier versions left opens, checks, verifies and goes on."""

from pathlib import Path

import pytest

from avrgym.replay.verification import verify
from avrgym.study.recording import read_recording

DATA = Path(__file__).parent / "data"
RECORDINGS = sorted(DATA.rglob("*.mcap"))


@pytest.mark.parametrize("path", RECORDINGS, ids=lambda path: path.stem)
def test_recordings_of_earlier_versions_verify(path: Path) -> None:
    found = verify(read_recording(path))
    assert found.complete
    assert found.steps > 0
    assert found.agrees
