"""Selection of streams of other devices in a study or a command."""

from pathlib import Path

import pytest

from avrgym.study.design.design import DesignError, parse_design, read_default_design_text
from avrgym.study.storage.store import StudyStore
from avrgym.vr.lab_streaming.stream_settings import StreamSettings, parse_stream_options
from helpers.browser.documentation import DOCS, blocks
from helpers.studies.small_studies import make_study

DEFAULT = "[streams]\nsend = false\nreceive = {}\n"


def test_studies_exchange_no_streams_by_default(tmp_path: Path) -> None:
    with StudyStore(make_study(tmp_path)) as store:
        assert store.design.streams == StreamSettings()
    assert parse_design(read_default_design_text().replace(DEFAULT, "")).streams == StreamSettings()


def test_documented_example_is_valid() -> None:
    (added,) = (text for language, text in blocks(DOCS / "how_to" / "other_devices.md") if language == "toml")
    streams = parse_design(read_default_design_text().replace(DEFAULT, added)).streams
    assert streams.send
    assert streams.receive == {"heart": "type='ECG'", "gaze": "name='Tracker' and hostname='lab-3'"}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('receive = { heart = "ECG" }', "'ECG' is not a valid stream query; allowed: name='…'"),
        ("receive = { heart = \"type='ECG' or true()\" }", "is not a valid stream query"),
        (
            'receive = { "my heart" = "type=\'ECG\'" }',
            "'my heart' is not a valid stream name; allowed: a letter",
        ),
        ("recieve = {}", "unknown name 'recieve'; allowed: send, receive"),
    ],
    ids=["no query", "more than a query", "name", "field"],
)
def test_error_of_an_invalid_stream_has_its_line(line: str, words: str) -> None:
    text = read_default_design_text().replace("receive = {}", line)
    number = next(n for n, each in enumerate(text.splitlines(), start=1) if each == line)
    with pytest.raises(DesignError) as refused:
        parse_design(text)
    assert str(refused.value).startswith(f"study.toml:{number}: ")
    assert words in str(refused.value)


def test_options_select_the_same_streams() -> None:
    assert parse_stream_options(True, ["heart=type='ECG'"]) == StreamSettings(True, {"heart": "type='ECG'"})
    with pytest.raises(ValueError, match="--receive heart: '' is not a valid stream query; allowed: name="):
        parse_stream_options(False, ["heart"])
