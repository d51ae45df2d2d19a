"""A hosted study at two sites with dropouts: check, merge, analysis and export.

Run it with other numbers: ``python tests/soak/soak_host_study.py PARTICIPANTS`` (of each site).
"""

import json
import re
import subprocess
import sys
import tempfile
from collections import Counter
from html import unescape
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.store import StudyStore
from helpers.hosting.emulated_participants import Course
from helpers.hosting.hosted_participants import DESIGN, SETTINGS, take_part_in_other_process
from helpers.hosting.served_host import host_process
from helpers.studies.small_studies import make_study
from helpers.system.processes import AVRGYM

COURSES: tuple[Course, ...] = ("completes", "is screened out", "completes", "withdraws", "leaves")
SHORT = DESIGN | {"practice_policy": '""', "trial_steps": "30", "free_movement_s": "0.5"}
SITES = ("atlanta", "berlin")
SHORT_ABSENCE = SETTINGS.replace("absence_minutes = 2", "absence_minutes = 0.3")


def test_hosted_study_with_dropouts_is_analysed(tmp_path: Path) -> None:
    found = study_with_dropouts(tmp_path, participants=5)
    print(json.dumps(found, indent=2))
    assert found["outcomes"] == {"completed": 4, "screened_out": 2, "withdrawn": 2, "left": 2}
    assert found["exit_codes"] == dict.fromkeys(found["exit_codes"], 0)
    flow = " ".join(found["flow"])
    for text in (
        "Enrolled: 10",
        "2 excluded by",
        "2 withdrew",
        "2 not finished yet",
        "Completed the study: 4",
    ):
        assert text in flow, text


def study_with_dropouts(folder: Path, participants: int) -> dict[str, Any]:
    """Host a study at two sites, and evaluate it with the commands. Returns figures."""
    outcomes = Counter[str]()
    for site in SITES:
        study = make_study(folder / site, **SHORT, site=f'"{site}"')
        (study / "host.toml").write_text(SHORT_ABSENCE)
        with StudyStore(study) as store, host_process(store) as (host, _):
            invitations = [each.token for each in create_invitations(store, [""] * participants, days=1)]
            people = take_part_in_other_process(f"http://localhost:{host.port}", invitations, COURSES)
            outcomes.update(each["ending"] or each["error"] or "left" for each in people)
    return {"outcomes": dict(outcomes)} | evaluate(folder)


def evaluate(folder: Path) -> dict[str, Any]:
    """Check, merge, analyse and export the studies of both sites with the commands. Returns figures."""
    merged, exported = folder / "all", folder / "exported"
    commands = (
        *(("study", "check", folder / site) for site in SITES),
        ("study", "quality", folder / SITES[0]),
        ("study", "merge", *(folder / site for site in SITES), "--out", merged),
        ("study", "check", merged),
        ("analyze", merged, "--json", folder / "analysis.json"),
        ("study", "export", merged, "--format", "csv", "--out", exported),
        ("study", "export", merged, "--format", "bids", "--out", folder / "bids"),
    )
    codes: dict[str, int] = {}
    for command in commands:
        done = subprocess.run([AVRGYM, *command], text=True, capture_output=True)
        name = " ".join(map(str, command)).replace(f"{folder}/", "")
        print(f"$ avrgym {name}\n{done.stdout}{done.stderr}", flush=True)
        codes[name] = done.returncode
    (page,) = merged.rglob("reporting/index.html")
    (section,) = re.findall(r'<section id="flow">(.*?)</section>', page.read_text(), re.DOTALL)
    return {
        "exit_codes": codes,
        "flow": [text for each in re.split(r"<[^>]*>", section) if (text := unescape(each).strip())],
        "exported_files": sum(1 for each in exported.rglob("*") if each.is_file()),
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        print(json.dumps(study_with_dropouts(Path(temporary), int(sys.argv[1])), indent=2))
