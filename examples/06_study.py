"""A whole study, simulated and analysed: ``python 06_study.py [PARTICIPANTS] [TRIAL_STEPS]``

Writes the study into the folder ``my-study``. All participants are simulated.
"""

import re
import sys
from pathlib import Path

from avrgym.analysis.output_files import write_analysis
from avrgym.analysis.study_analysis import analyse_study
from avrgym.study.sessions.dry_run import simulate_study
from avrgym.study.storage.store import StudyStore, create_study

PARTICIPANTS = int(sys.argv[1]) if len(sys.argv) > 1 else 4
TRIAL_STEPS = int(sys.argv[2]) if len(sys.argv) > 2 else 200
CHANGES = {
    "tasks": '["Feeding"]',
    "robots": '["Jaco"]',
    "practice_policy": '""',
    "free_movement_s": "1.0",
    "trial_steps": str(TRIAL_STEPS),
}


def main() -> None:
    """Design, rehearsal, results."""
    folder = Path("my-study")
    design = create_study(folder)
    text = design.read_text()
    for name, value in CHANGES.items():
        text = re.sub(rf"^{name} = .*$", f"{name} = {value}", text, flags=re.M)
    design.write_text(text)

    simulate_study(folder, PARTICIPANTS, seed=1)
    with StudyStore(folder) as store:
        analysis = analyse_study(store)
        report = write_analysis(analysis, folder, folder / "analysis")
    for row in analysis.objective_outcomes:
        print(f"{row.task} {row.robot} {row.policy}: {row.successes} of {row.trials} trials succeeded")
    for test in analysis.tests:
        print(f"{test.family}, {test.quantity}, by {test.unit}: n = {test.n}, p = {test.p}")
    print(f"report: {report}")


if __name__ == "__main__":  # other processes import this file
    main()
