"""A few trials with faults at random times; `make soak` runs 200."""

from pathlib import Path

import pytest

from avrgym.study.storage.store import StudyStore
from helpers.studies.faulty_study import INTERRUPTIONS, Expected, Fault, FaultyStudy
from helpers.studies.small_studies import make_study


@pytest.mark.slow
def test_expected_attempts_count(tmp_path: Path) -> None:
    protocol = {"free_movement_s": "0.4", "trial_steps": "10", "practice_policy": '""'}
    with StudyStore(make_study(tmp_path, tasks='["Feeding"]', robots='["Jaco"]', **protocol)) as store:
        study = FaultyStudy(store, seed=3)
        study.run(2)
        print(f"\n{study.counts()}")
        assert study.faults() == []


def test_expected_result_covers_each_fault() -> None:
    def counts(kind: str, where: str, lasts_s: float, part: str = "head") -> bool | None:
        return Expected(Fault(kind, where, 0.0, lasts_s, part), ("head",), 1.0, where, 9.0).counts

    for kind in INTERRUPTIONS:
        assert not counts(kind, "trial", 0.1)
        assert counts(kind, "questionnaire", 2.5)
    assert not counts("limb", "trial", 2.5)
    assert counts("limb", "trial", 0.6)
    assert counts("limb", "trial", 2.5, "left")
    assert counts("frames", "free_after", 2.5)
