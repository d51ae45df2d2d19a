"""Read the recording of a trial, up to where a crash may have ended it."""

import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from typing import Any

import msgspec
from mcap import records as mcap_records
from mcap.stream_reader import StreamReader, breakup_chunk

from avrgym.recording import answers_file
from avrgym.recording.schema import ATTEMPT_ENDS, TOPICS, AttemptEnd, Metrics, decode

CONFIGURATION = "configuration"
OUTCOME = "outcome"
ROBOT_FINISHED = "robot_finished"
ORIGIN = "origin"
"""When the recording began, by the computer's calendar."""


class RecordingError(Exception):
    """A recording that cannot be written completely, or a file that is none."""


@dataclass(frozen=True)
class Recording:
    """The contents of a file: its messages (topic, log_time_ns, record) in the order of writing.

    ``complete``: the trial ended with an outcome and nothing is missing. ``began_at``: when the trial began, in UTC;
    recordings of earlier versions do not contain it. ``robot_finished`` is the outcome at the end of the last control
    step, where the robot took all of them.
    """

    metadata: dict[str, Any]
    outcome: dict[str, Any] | None
    messages: list[tuple[str, int, Any]]
    complete: bool
    began_at: datetime | None = None
    robot_finished: dict[str, Any] | None = None

    @property
    def end(self) -> AttemptEnd | None:
        """How the attempt ended; ``None`` where the recording does not say it, or something that nobody knows."""
        result = (self.outcome or {}).get("result")
        return result if result in ATTEMPT_ENDS else None

    @property
    def metrics(self) -> Metrics:
        """What the attempt gave, as far as the recording says."""
        try:
            return msgspec.convert(self.outcome or {}, Metrics)
        except msgspec.ValidationError:
            return Metrics()

    @property
    def torso_height_m(self) -> float | None:
        """The torso height of the person's body, if the configuration tells it."""
        return torso_height_m(self.metadata)

    @cached_property
    def topics(self) -> dict[str, list[tuple[int, Any]]]:
        """By topic (log_time_ns, record), every topic present."""
        topics: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in TOPICS}
        for topic, log_time_ns, record in self.messages:
            topics[topic].append((log_time_ns, record))
        return topics


def read_recording(path: str | os.PathLike[str]) -> Recording:
    """Read a recording up to where a crash or damage may have ended it; ``RecordingError`` without a header.

    Answers that were given after its end, see ``answers_file``, follow its messages at the time of the last one.
    """
    records, whole, _ = intact_records(path)
    metadata = _metadata(records)
    if CONFIGURATION not in metadata:
        raise RecordingError(f"{path}: not a recording, or cut off before the end of its header")
    messages, gapless = _messages(path, records)
    ends_ns = max((time_ns for _, time_ns, _ in messages), default=0)
    messages += [("/answers", ends_ns, answer) for answer in answers_file.read_answers(path)]
    outcome = metadata.get(OUTCOME)
    return Recording(
        metadata=metadata[CONFIGURATION],
        outcome=outcome,
        messages=messages,
        complete=whole and gapless and outcome is not None,
        began_at=_began_at(metadata.get(ORIGIN, {})),
        robot_finished=metadata.get(ROBOT_FINISHED) if gapless else None,
    )


def _began_at(origin: Mapping[str, Any]) -> datetime | None:
    try:
        return datetime.fromisoformat(origin["began_at"])
    except (KeyError, TypeError, ValueError):
        return None


def read_configuration(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read only the configuration of a trial, which begins its recording; ``RecordingError`` where there is none."""
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, mcap_records.Metadata) and record.name == CONFIGURATION:
                    return _from_text(record.metadata)
        except OSError:
            raise
        except Exception as error:  # the reader raises whatever damaged bytes lead to
            raise RecordingError(f"{path}: damaged: {error}") from error
    raise RecordingError(f"{path}: not a recording")


def read_beginning(path: str | os.PathLike[str]) -> datetime | None:
    """When a trial began by its recording, which is read no further; ``RecordingError`` for a damaged beginning."""
    with open(path, "rb") as file:
        try:
            for record in StreamReader(file, emit_chunks=True).records:
                if isinstance(record, mcap_records.Metadata) and record.name == ORIGIN:
                    return _began_at(_from_text(record.metadata))
                if isinstance(record, mcap_records.Chunk):
                    return None
        except OSError:
            raise
        except Exception as error:  # the reader raises whatever damaged bytes lead to
            raise RecordingError(f"{path}: damaged: {error}") from error
    return None


def torso_height_m(configuration: Mapping[str, Any]) -> float | None:
    """The torso height of the person's body in a trial, if its configuration tells it."""
    person: Mapping[str, Any] = configuration.get("person") or {}
    return person.get("torso_height_m")


def intact_records(path: str | os.PathLike[str]) -> tuple[list[mcap_records.McapRecord], bool, int]:
    """The records before the first damage, whether there was none, and the offset behind the last record of the data.

    Messages lie in chunks, each of which has a checksum: a message outside of them is damage to another record's kind.
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
        except Exception:  # the reader raises whatever the bytes of a cut or damaged record lead to
            return records, False, end_of_data
    return records, True, end_of_data


def _metadata(records: list[mcap_records.McapRecord]) -> dict[str, dict[str, Any]]:
    metadata: dict[str, dict[str, Any]] = {}
    for record in records:
        if isinstance(record, mcap_records.Metadata):
            with suppress(msgspec.DecodeError):
                metadata[record.name] = _from_text(record.metadata)
    return metadata


def _messages(
    path: str | os.PathLike[str], records: list[mcap_records.McapRecord]
) -> tuple[list[tuple[str, int, Any]], bool]:
    """The messages before the first gap in their numbers, and whether there was none; 0 is no number."""
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
                messages.append((topic, record.log_time, decode(topic, record.data)))
            except (KeyError, msgspec.DecodeError) as error:
                allowed = ", ".join(TOPICS)
                raise RecordingError(f"{path}: foreign {topic!r}: {error}; allowed: {allowed}") from error
    return messages, True


def _from_text(texts: Mapping[str, str]) -> dict[str, Any]:
    return {name: msgspec.json.decode(text) for name, text in texts.items()}
