"""Each measure of the threat model names existing tests."""

import re
from pathlib import Path

TESTS = Path(__file__).parent
THREAT_MODEL = TESTS.parents[1] / "deploy" / "threat_model.md"


def test_each_threat_names_existing_tests() -> None:
    section = THREAT_MODEL.read_text().partition("## Threats")[2].partition("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("| ")][1:]
    assert len(rows) > 20
    for row in rows:
        named = re.findall(r"`(\S+\.py)::(test_\w+)`", row)
        assert named, row
        for file, test in named:
            assert f"def {test}(" in (TESTS / file).read_text(), row
