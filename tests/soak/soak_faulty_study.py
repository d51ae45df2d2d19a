"""200 trials with lost tracking, device switches, menus, network failures and server restarts: `make soak`."""

from pathlib import Path

from avrgym.study.storage.store import StudyStore
from helpers.studies.faulty_study import FaultyStudy
from helpers.studies.small_studies import make_study

PARTICIPANTS = 25
PROTOCOL = {"free_movement_s": "0.4", "trial_steps": "25", "practice_policy": '""'}


def test_only_valid_trials_are_completed_and_none_is_lost(tmp_path: Path) -> None:
    folder = make_study(tmp_path, tasks='["Feeding", "ScratchItch"]', **PROTOCOL)
    with StudyStore(folder) as store:
        study = FaultyStudy(store, seed=1)
        study.run(PARTICIPANTS)
        trials = sum(len(store.read_trials(each.pseudonym)) for each in store.read_participants())
        print(f"\n{trials} trials, {sum(map(len, study.attempts.values()))} attempts")
        for what, count in sorted(study.counts().items()):
            print(f"{count:4}  {what}")
        assert trials >= 200
        assert study.faults() == []
