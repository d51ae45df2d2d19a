"""Reads the recording of a trial. The recording may be complete, or truncated by a crash."""

import os
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any, NamedTuple

import msgspec
from mcap import records as mcap_records
from mcap.stream_reader import StreamReader, breakup_chunk

from avrgym.recording import answers_file
from avrgym.recording.configuration import TrialConfiguration, parse_configuration
from avrgym.recording.schema import TOPICS, AttemptEnd, Metrics, Outcome, decode

CONFIGURATION_RECORD, START_TIME_RECORD = "configuration", "origin"
"""Names of the metadata records at the beginning. ``origin`` contains date and time."""
OUTCOME_RECORD, ROBOT_FINISHED_RECORD = "outcome", "robot_finished"
"""Names of the metadata records at the end of the trial, and at the end of its last control step."""
_NO_RECORDING = "not a recording, or truncated before the end of its header; restore a backup"


class RecordingError(Exception):
    """Raised if a recording cannot be written completely, or if a file is not a valid recording."""


class RecordingHeader(NamedTuple):
    """The first records of a recording: configuration and start time (UTC)."""

    configuration: TrialConfiguration
    began_at: datetime


@dataclass(frozen=True)
class Recording:
    """Contents of a recording.

    Attributes:
        configuration: all parameters of the trial.
        outcome: result and metrics of the attempt; ``None`` if the recording is truncated.
        messages: all messages (topic, log_time_ns, record), in the order in which they were written.
        is_complete: whether the recording has an outcome and contains all data.
        began_at: start of the trial, UTC.
        robot_outcome: the outcome at the end of the last control step; ``None`` if the robot did not finish.
    """

    configuration: TrialConfiguration
    outcome: Outcome | None
    messages: list[tuple[str, int, Any]]
    is_complete: bool
    began_at: datetime
    robot_outcome: Outcome | None = None

    @property
    def result(self) -> AttemptEnd | None:
        """Result of the attempt, one of ``ATTEMPT_ENDS``; ``None`` if the recording is truncated."""
        return None if self.outcome is None else self.outcome.result

    @property
    def metrics(self) -> Metrics:
        """The metrics of the attempt; unknown metrics are ``None``."""
        if self.outcome is None:
            return Metrics()
        return Metrics(**{name: getattr(self.outcome, name) for name in Metrics.__struct_fields__})

    @property
    def duration_s(self) -> float:
        """Time of the last message, in seconds from the start of the trial."""
        return max((time_ns for _, time_ns, _ in self.messages), default=0) / 1e9

    @cached_property
    def messages_by_topic(self) -> dict[str, list[tuple[int, Any]]]:
        """Messages (log_time_ns, record) by topic."""
        topics: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in TOPICS}
        for topic, log_time_ns, record in self.messages:
            topics[topic].append((log_time_ns, record))
        return topics


def read_recording(path: str | os.PathLike[str], *, undecoded: Collection[str] = ()) -> Recording:
    """Reads a recording up to its end, or up to the first damaged data. Returns its contents.

    The answers of the answers file (see ``answers_file``) are appended, with the time of the last message. Records of
    the topics ``undecoded`` remain JSON bytes, which saves time.

    Raises:
        RecordingError: if the file has no valid header.
    """
    records, whole, _ = read_intact_records(path)
    header = _header(path, records)
    messages, gapless = _messages(path, records, undecoded)
    ends_ns = max((time_ns for _, time_ns, _ in messages), default=0)
    messages += [("/answers", ends_ns, answer) for answer in answers_file.read_answers(path)]
    metadata = _metadata(records)
    outcome = _outcome(metadata.get(OUTCOME_RECORD))
    return Recording(
        configuration=header.configuration,
        outcome=outcome,
        messages=messages,
        is_complete=whole and gapless and outcome is not None,
        began_at=header.began_at,
        robot_outcome=_outcome(metadata.get(ROBOT_FINISHED_RECORD)) if gapless else None,
    )


def read_header(path: str | os.PathLike[str]) -> RecordingHeader:
    """Returns configuration and start time of a recording. Raises ``RecordingError`` if they are missing or invalid."""
    with open(path, "rb") as file:
        try:
            return _header(path, StreamReader(file, emit_chunks=True).records)
        except (OSError, RecordingError):
            raise
        except Exception as error:  # the MCAP reader raises any exception on damaged bytes
            raise RecordingError(f"{path} is damaged: {error}; restore a backup") from error


def _header(path: str | os.PathLike[str], records: Iterable[mcap_records.McapRecord]) -> RecordingHeader:
    metadata: dict[str, dict[str, Any]] = {}
    for record in records:
        if isinstance(record, mcap_records.Chunk | mcap_records.Message):
            break
        metadata |= _metadata([record])
        if CONFIGURATION_RECORD in metadata and START_TIME_RECORD in metadata:
            try:
                began_at = datetime.fromisoformat(metadata[START_TIME_RECORD]["began_at"])
                return RecordingHeader(parse_configuration(metadata[CONFIGURATION_RECORD]), began_at)
            except (KeyError, TypeError, ValueError) as error:
                raise RecordingError(
                    f"{path}: the configuration in this recording is not valid: {error}; restore a backup"
                ) from error
    raise RecordingError(f"{path}: {_NO_RECORDING}")


def read_intact_records(path: str | os.PathLike[str]) -> tuple[list[mcap_records.McapRecord], bool, int]:
    """Returns the intact records of a file, whether the file is undamaged, and a byte offset.

    The intact records are those before the first damage. The offset is the end of the last intact data record.

    All messages are in chunks with checksums. A message outside a chunk is therefore a damaged record of another type.
    """
    records: list[mcap_records.McapRecord] = []
    end_of_data, ended = 0, False
    with open(path, "rb") as file:
        reader = StreamReader(
            file, emit_chunks=True, validate_crcs=True, record_size_limit=os.path.getsize(path)
        )
        try:
            for record in reader.records:
                if isinstance(record, mcap_records.Chunk):
                    records += breakup_chunk(record, validate_crc=True)
                elif isinstance(record, mcap_records.Message):
                    return records, False, end_of_data
                else:
                    records.append(record)
                ended = ended or isinstance(record, mcap_records.DataEnd)
                end_of_data = end_of_data if ended else file.tell()
        except OSError:
            raise
        except Exception:  # the MCAP reader raises any exception on damaged bytes
            return records, False, end_of_data
    return records, True, end_of_data


def _metadata(records: Iterable[mcap_records.McapRecord]) -> dict[str, dict[str, Any]]:
    metadata: dict[str, dict[str, Any]] = {}
    for record in records:
        if isinstance(record, mcap_records.Metadata):
            with suppress(msgspec.DecodeError):
                metadata[record.name] = _from_text(record.metadata)
    return metadata


def _outcome(values: dict[str, Any] | None) -> Outcome | None:
    with suppress(msgspec.ValidationError):
        return None if values is None else msgspec.convert(values, Outcome)
    return None


def _messages(
    path: str | os.PathLike[str], records: list[mcap_records.McapRecord], undecoded: Collection[str]
) -> tuple[list[tuple[str, int, Any]], bool]:
    """Returns the messages before the first gap in the sequence numbers, and whether there is no gap.

    Sequence number 0 means that a message has no number.
    """
    names: dict[int, str] = {}
    messages: list[tuple[str, int, Any]] = []
    for record in records:
        if isinstance(record, mcap_records.Channel):
            names.setdefault(record.id, record.topic)
        elif isinstance(record, mcap_records.Message):
            if record.sequence not in (0, len(messages) + 1):
                return messages, False
            topic = names.get(record.channel_id, f"channel {record.channel_id}")
            try:
                value = record.data if topic in undecoded else decode(topic, record.data)
                messages.append((topic, record.log_time, value))
            except (KeyError, msgspec.DecodeError) as error:
                allowed = ", ".join(TOPICS)
                raise RecordingError(
                    f"{path}: invalid message in {topic!r}: {error}; allowed: {allowed}"
                ) from error
    return messages, True


def _from_text(texts: dict[str, str]) -> dict[str, Any]:
    return {name: msgspec.json.decode(text) for name, text in texts.items()}
