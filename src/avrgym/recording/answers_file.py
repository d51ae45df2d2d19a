"""Answers that were given after the end of their attempt: lines of JSON in a file next to its recording."""

import os
from datetime import UTC, datetime
from pathlib import Path

import msgspec

from avrgym.recording.schema import Answer

SUFFIX = ".answers.jsonl"


class LateAnswer(msgspec.Struct, frozen=True):
    """One answer, and when it was given, in UTC."""

    item: str
    value: int
    response_time_s: float
    answered_at: str


def answers_path(recording: str | os.PathLike[str]) -> Path:
    """The file of the answers to a recording, which may not exist."""
    return Path(recording).with_suffix(SUFFIX)


def append_answer(recording: Path, answer: Answer) -> None:
    """Add an answer; on return it is on disk. ``OSError`` when it cannot be written."""
    at = datetime.now(UTC).isoformat(timespec="microseconds")
    late = LateAnswer(answer.item, answer.value, answer.response_time_s, at)
    with open(os.open(answers_path(recording), os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o600), "ab") as file:
        file.write(msgspec.json.encode(late) + b"\n")
        file.flush()
        os.fsync(file.fileno())


def read_answers(recording: str | os.PathLike[str]) -> list[Answer]:
    """The answers in the order they were given; a line that a crash cut off is left out."""
    return [Answer(each.item, each.value, each.response_time_s) for each in _lines(recording)]


def answer_times(recording: str | os.PathLike[str]) -> dict[str, str]:
    """When the latest late answer to each item was given, ISO 8601 in UTC."""
    return {each.item: each.answered_at for each in _lines(recording)}


def _lines(recording: str | os.PathLike[str]) -> list[LateAnswer]:
    path = answers_path(recording)
    if not path.is_file():
        return []
    lines = path.read_bytes().split(b"\n")[:-1]
    return [msgspec.json.decode(line, type=LateAnswer) for line in lines if line]
