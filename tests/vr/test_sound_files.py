"""Sound files of a study: only files with a valid name in the study's own folder are found."""

from pathlib import Path

import pytest

from avrgym.vr.server.sound_files import find_sound_file


@pytest.mark.parametrize(
    ("language", "name", "found"),
    [
        ("de", "ready", True),
        ("en", "ready", False),
        ("de", "nothing", False),
        ("de", "ready.wav", False),
        ("de", "../../secret", False),
        ("..", "secret", False),
    ],
)
def test_only_sound_files_of_the_study_are_found(
    language: str, name: str, found: bool, tmp_path: Path
) -> None:
    (tmp_path / "sounds/de").mkdir(parents=True)
    file = tmp_path / "sounds/de/ready.wav"
    for each in (file, tmp_path / "secret.wav"):
        each.write_bytes(b"RIFF")
    assert find_sound_file(tmp_path / "sounds", language, name) == (file if found else None)
