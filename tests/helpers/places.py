"""Where the repository, these helpers and the tests' data lie."""

from pathlib import Path

HELPERS = Path(__file__).parent
ROOT = HELPERS.parents[1]
DATA = ROOT / "tests" / "data"
