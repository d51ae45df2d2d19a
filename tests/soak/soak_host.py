"""Many participants of a hosted study at the same time: with killed sessions, and over the network of this computer.

Run one with other numbers: ``python tests/soak/soak_host.py PARTICIPANTS KILLS``.
"""

import json
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from helpers.hosting.hosted_participants import host_participants


def test_participants_with_killed_sessions(tmp_path: Path) -> None:
    figures = host_participants(tmp_path / "study", participants=6, kills=4)
    print(json.dumps(figures, indent=2))
    assert figures["completed"] == 6
    assert figures["lost_trials"] == 0
    assert figures["faults"] == []


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        print(
            json.dumps(
                host_participants(Path(temporary) / "study", int(sys.argv[1]), int(sys.argv[2])), indent=2
            )
        )
