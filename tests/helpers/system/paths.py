"""Paths of the repository and of the tests' data."""

from pathlib import Path

ROOT = Path(__file__).parents[3]
TESTS = ROOT / "tests"
DATA = TESTS / "data"
OLD_RECORDING = DATA / "study-of-0.2.0" / "recordings" / "sub-001" / "ses-01" / "trial-01_attempt-1.mcap"
"""A trial of ScratchItchJaco, recorded by version 0.2.0."""
