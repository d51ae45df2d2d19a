"""Exports detect damage to recordings at many positions: `make soak`."""

from pathlib import Path

import pytest

from avrgym.study.storage import database
from avrgym.study.storage.store import StudyStore
from helpers.studies.damaged_recordings import count_undetected
from helpers.studies.small_studies import enrol_with_consent, run_participant, small_study

DAMAGES = 5000


def test_damage_at_any_byte_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(database.DATABASE_URL_VARIABLE, raising=False)
    folder = small_study(tmp_path / "study")
    with StudyStore(folder) as store:
        run_participant(store, enrol_with_consent(store))
    undetected = count_undetected(folder, DAMAGES)
    print(f"\n{DAMAGES} damaged recordings, {undetected} exported")
    assert undetected == 0
