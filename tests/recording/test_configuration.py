"""The configuration in a recording: every field is stored, old recordings open, newer formats are refused."""

from pathlib import Path

import pytest
from msgspec.structs import replace

from avrgym.questionnaires.stop_rules import StopRule
from avrgym.recording.configuration import FORMAT_VERSION, RecordedConsent
from avrgym.recording.reader import RecordingError, read_header, read_recording
from avrgym.recording.writer import RecordingWriter
from helpers.studies.configurations import configuration
from helpers.system.paths import OLD_RECORDING


def test_a_recording_stores_every_field(tmp_path: Path) -> None:
    written = configuration(
        free_movement_s=3.0,
        stop_rules=(StopRule("nausea", 3.0, "end"),),
        consent=RecordedConsent("2026-01-01T00:00:00+00:00", "1"),
    )
    path = tmp_path / "trial.mcap"
    RecordingWriter(path, written).close()
    assert read_header(path).configuration == written


def test_a_recording_of_0_2_opens_without_the_later_fields() -> None:
    recording = read_recording(OLD_RECORDING)
    read = recording.configuration
    assert recording.is_complete
    assert (read.format_version, read.free_movement_s, read.stop_rules) == (1, None, None)
    assert (read.person.sex, read.versions.mujoco) == ("man", "4.0.0")


def test_a_newer_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "trial.mcap"
    RecordingWriter(path, replace(configuration(), format_version=FORMAT_VERSION + 1)).close()
    with pytest.raises(RecordingError, match="pip install --upgrade avrgym"):
        read_recording(path)


def test_an_invalid_field_is_named(tmp_path: Path) -> None:
    path = tmp_path / "trial.mcap"
    RecordingWriter(path, replace(configuration(), seed="three")).close()
    with pytest.raises(RecordingError, match="seed"):
        read_header(path)
