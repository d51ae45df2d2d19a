"""Answers that a participant gives after the end of a recording: a JSON Lines file next to the recording."""

import os
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from avrgym.recording.schema import Answer

ANSWERS_SUFFIX = ".answers.jsonl"


class StoredAnswer(msgspec.Struct, frozen=True):
    """One answer to a questionnaire item, with its time stamp (ISO 8601, UTC)."""

    item: str
    value: int
    response_time_s: float
    answered_at: str


def get_answers_path(recording: str | os.PathLike[str]) -> Path:
    """Returns the path of a recording's answers file.

    The file exists only if the participant has given answers after the end of the recording.
    """
    return Path(recording).with_suffix(ANSWERS_SUFFIX)


def append_answer(recording: Path, answer: Answer) -> None:
    """Append an answer to the answers file of ``recording``, and sync the file to disk. Raises ``OSError`` if the file
    cannot be written.
    """
    at = datetime.now(UTC).isoformat(timespec="microseconds")
    stored = StoredAnswer(answer.item, answer.value, answer.response_time_s, at)
    with open(
        os.open(get_answers_path(recording), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "ab"
    ) as file:
        file.write(msgspec.json.encode(stored) + b"\n")
        file.flush()
        os.fsync(file.fileno())


def read_answers(recording: str | os.PathLike[str]) -> list[Answer]:
    """Returns all answers in the answers file of a recording, in order. An incomplete last line is ignored."""
    return [Answer(each.item, each.value, each.response_time_s) for each in _lines(recording)]


def read_answer_timestamps(recording: str | os.PathLike[str]) -> dict[str, str]:
    """Returns the time stamp (ISO 8601, UTC) of the latest answer to each item, by item id."""
    return {each.item: each.answered_at for each in _lines(recording)}


def _lines(recording: str | os.PathLike[str]) -> list[StoredAnswer]:
    path = get_answers_path(recording)
    if not path.is_file():
        return []
    lines = path.read_bytes().split(b"\n")[:-1]
    return [msgspec.json.decode(line, type=StoredAnswer) for line in lines if line]
