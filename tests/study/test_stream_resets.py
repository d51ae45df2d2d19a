"""Clock jumps of a device in check, analysis and export."""

import csv
import gzip
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from avrgym.analysis.reading.study_data import read_study_data
from avrgym.analysis.reading.table_rows import StreamRow
from avrgym.recording.schema import StreamSamples
from avrgym.study.checking.study_checks import check_study
from avrgym.study.export import export_study
from avrgym.study.storage.store import StudyStore
from helpers.studies import small_studies
from helpers.studies.small_studies import (
    HEARTBEATS,
    SAMPLES,
    enrol_with_consent,
    run_participant,
    small_study,
)

JUMP_S = -1.0
JUMPED = StreamSamples(
    "heart",
    0.001,
    [0.1 + 0.01 * number + (JUMP_S if number >= 15 else 0.0) for number in range(30)],
    HEARTBEATS,
)


@pytest.fixture
def store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StudyStore]:
    monkeypatch.setattr(small_studies, "SAMPLES", (JUMPED, *SAMPLES[1:]))
    with StudyStore(small_study(tmp_path / "study")) as opened:
        run_participant(opened, enrol_with_consent(opened), trials=2)
        yield opened


def test_clock_jump_is_a_note(store: StudyStore) -> None:
    found = [each for each in check_study(store) if "clock" in each.message]
    assert len(found) == 2
    assert not any(each.is_error for each in found)
    assert "the clock of the stream heart jumped: -1.000 s at 0.2 s" in found[0].message


def test_analysis_counts_a_reset_and_no_gap(store: StudyStore) -> None:
    heart = [row for row in read_study_data(store).streams if row.stream == "heart"]
    assert [(row.gaps, row.clock_resets, round(row.clock_jump_s, 3)) for row in heart] == [(0, 1, JUMP_S)] * 2
    assert isinstance(heart[0], StreamRow)
    assert heart[0].measured_hz == pytest.approx(100.0)


def test_bids_times_rise_and_corrections_are_documented(store: StudyStore, tmp_path: Path) -> None:
    export_study(store, "bids", tmp_path / "bids")
    for path in (tmp_path / "bids").rglob("*_recording-heart_physio.tsv.gz"):
        with gzip.open(path, "rt") as file:
            times_s = [float(row[0]) for row in csv.reader(file, delimiter="\t")]
        assert times_s == pytest.approx([0.01 * number for number in range(30)], abs=1e-9)
        sidecar = json.loads(path.with_suffix("").with_suffix(".json").read_text())
        (reset,) = sidecar["timestamp"]["ClockResets"]
        assert reset["JumpInSeconds"] == pytest.approx(JUMP_S)
