"""Writes the recording of a trial as an MCAP file. After a crash, the file can be read up to the last written data."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import IO, Any, cast

import msgspec
from mcap import records as mcap_records
from mcap.data_stream import RecordBuilder
from mcap.writer import MCAP0_MAGIC, Writer

from avrgym.recording.configuration import TrialConfiguration
from avrgym.recording.reader import (
    CONFIGURATION_RECORD,
    OUTCOME_RECORD,
    ROBOT_FINISHED_RECORD,
    START_TIME_RECORD,
    RecordingError,
    read_intact_records,
    read_recording,
)
from avrgym.recording.schema import TOPICS, Outcome, Record, encode, make_json_schema
from avrgym.system.files import open_privately

FLUSH_INTERVAL_S = 0.1
"""Interval at which queued records are written to the file."""
DISK_STALL_TIMEOUT_S = 0.75
"""Maximum duration of a write. After this time, ``RecordingWriter.disk_error`` reports a stalled disk."""
MAX_QUEUED_MESSAGES = 4000
"""Maximum length of the queue. If it is full, the recording fails."""
MAX_SHORT_QUEUE_MESSAGES = 100
"""Maximum length of the queue at which ``RecordingWriter.wait_for_writes`` returns."""
CLOSE_TIMEOUT_S = 10.0
"""Maximum time in which ``RecordingWriter.close`` waits for the disk."""


class RecordingWriter:
    """Writes the recording of one trial in a separate thread. ``write`` never waits for the disk.

    Data reach the file within half a second. ``disk_error`` reports a disk failure within a second. After a failure the
    file is never marked as complete.

    Args:
        path: the new file. Raises ``FileExistsError`` if the file exists.
        configuration: all parameters of the trial.
    """

    def __init__(self, path: str | os.PathLike[str], configuration: TrialConfiguration):
        self.path = Path(path)
        self._failure: Exception | None = None
        self._queue: SimpleQueue[tuple[str, int, Record] | Outcome | None] = SimpleQueue()
        self._disk = _Disk(self.path)
        self._mcap = Writer(cast(IO[bytes], self._disk), enable_data_crcs=True)
        self._written = 0
        self._channels = self._start(configuration)
        self._alive_at = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="recording", daemon=True)
        self._thread.start()

    @property
    def disk_error(self) -> Exception | None:
        """The error that prevents a complete recording, or ``None``. A ``TimeoutError`` is temporary, other errors are
        permanent."""
        silent_s = time.monotonic() - self._alive_at
        if self._failure is None and self._thread.is_alive() and silent_s > DISK_STALL_TIMEOUT_S:
            return TimeoutError(f"{self.path}: no data could be written for {silent_s:.1f} s; check the disk")
        return self._failure

    def write(self, topic: str, log_time_ns: int, record: Record) -> None:
        """Queue one record without waiting. ``log_time_ns`` is on the trial's monotonic clock.

        The record must not be changed afterwards. After a disk failure, the record is dropped.
        """
        if type(record) is not TOPICS.get(topic):
            allowed = ", ".join(f"{name}: {kind.__name__}" for name, kind in TOPICS.items())
            raise RecordingError(f"no topic {topic!r} for {type(record).__name__}; allowed: {allowed}")
        if self._disk.closed:
            raise RecordingError(
                f"{self.path} is closed and cannot store a record of {topic}; write records before close()"
            )
        if self._failure is None and self._queue.qsize() >= MAX_QUEUED_MESSAGES:
            self._failure = RecordingError(
                f"{self.path}: a record was lost: the disk is too slow; use a faster disk"
            )
        if self._failure is None:
            self._queue.put((topic, log_time_ns, record))

    def write_robot_outcome(self, outcome: Outcome) -> None:
        """Queue the outcome at the end of the last control step, without waiting.

        If the process is killed later, ``complete_truncated_recording`` completes the file with this outcome.
        """
        self._queue.put(outcome)

    def wait_for_writes(self) -> None:
        """Wait until the queue is short. Sessions in simulated time call this, because they are faster than the disk.

        After a disk failure, the method returns immediately.
        """
        while self._queue.qsize() > MAX_SHORT_QUEUE_MESSAGES and self.disk_error is None:
            time.sleep(0.001)

    def close(self, outcome: Outcome | None = None) -> None:
        """Write all queued records and close the file. If an outcome is given, mark the file as complete.

        A second call has no effect.

        Raises:
            RecordingError: if the disk accepts no data, or if an outcome is given and the file cannot be completed.
        """
        if self._disk.closed:
            return
        self._queue.put(None)
        self._thread.join(CLOSE_TIMEOUT_S)
        if self._thread.is_alive():
            raise RecordingError(
                f"{self.path}: the recording is incomplete: the disk does not accept data; check the disk"
            )
        if outcome is not None and self._failure is None:
            self._attempt(lambda: self._complete(outcome))
        self._disk.close()
        if outcome is not None and self._failure is not None:
            raise RecordingError(
                f"{self.path}: the recording is incomplete: {self._failure}"
            ) from self._failure

    def _start(self, configuration: TrialConfiguration) -> dict[str, int]:
        try:
            self._mcap.start(profile="", library="avrgym")
            self._mcap.add_metadata(CONFIGURATION_RECORD, _to_text(msgspec.to_builtins(configuration)))
            self._mcap.add_metadata(START_TIME_RECORD, _to_text({"began_at": datetime.now(UTC).isoformat()}))
        except BaseException:
            self._disk.close()
            self.path.unlink()
            raise
        return {topic: self._register(topic) for topic in TOPICS}

    def _register(self, topic: str) -> int:
        schema = self._mcap.register_schema(
            name=f"avrgym.{TOPICS[topic].__name__}", encoding="jsonschema", data=make_json_schema(topic)
        )
        return self._mcap.register_channel(topic=topic, message_encoding="json", schema_id=schema)

    def _run(self) -> None:
        self._attempt(self._write_queued)

    def _attempt(self, action: Callable[[], None]) -> None:
        try:
            action()
        except Exception as error:
            self._failure = self._failure or error

    def _write_queued(self) -> None:
        flush_at = time.monotonic() + FLUSH_INTERVAL_S
        going_on = True
        while going_on:
            with suppress(Empty):
                going_on = self._write_next(max(0.0, flush_at - time.monotonic()))
            self._alive_at = time.monotonic()
            if self._alive_at >= flush_at or not going_on:
                self._mcap.flush()
                flush_at = time.monotonic() + FLUSH_INTERVAL_S

    def _write_next(self, timeout_s: float) -> bool:
        entry = self._queue.get(timeout=timeout_s)
        if entry is None:
            return False
        if isinstance(entry, Outcome):
            self._mcap.flush()
            self._mcap.add_metadata(ROBOT_FINISHED_RECORD, _to_text(msgspec.to_builtins(entry)))
            return True
        topic, log_time_ns, record = entry
        self._written += 1
        self._mcap.add_message(
            self._channels[topic],
            log_time_ns,
            encode(record),
            publish_time=log_time_ns,
            sequence=self._written,
        )
        return True

    def _complete(self, outcome: Outcome) -> None:
        self._disk.sync()
        end_of_data = self._disk.tell()
        try:
            self._mcap.add_metadata(OUTCOME_RECORD, _to_text(msgspec.to_builtins(outcome)))
            self._mcap.finish()
            self._disk.sync()
        except BaseException:
            self._disk.cut(end_of_data)
            raise


class _Disk:
    """A new file without a buffer. A failed write is therefore not repeated later."""

    def __init__(self, path: Path):
        self._file = FileIO(path, "x", opener=open_privately)

    @property
    def closed(self) -> bool:
        return self._file.closed

    def write(self, data: bytes) -> None:
        rest = memoryview(data)
        while rest:
            rest = rest[self._file.write(rest) :]

    def flush(self) -> None:
        """Does nothing, because the file is unbuffered. The MCAP writer calls this method."""

    def tell(self) -> int:
        return self._file.tell()

    def sync(self) -> None:
        os.fsync(self._file.fileno())

    def cut(self, size: int) -> None:
        with suppress(OSError):
            self._file.truncate(size)

    def close(self) -> None:
        self._file.close()


def complete_truncated_recording(path: str | os.PathLike[str]) -> None:
    """Complete a recording that was truncated after the robot finished. Other recordings are not changed.

    The outcome replaces unreadable data at the end of the file. The file must not be open for writing.
    """
    recording = read_recording(path)
    if recording.is_complete or recording.robot_outcome is None:
        return
    end = RecordBuilder()
    if recording.outcome is None:
        outcome = msgspec.structs.replace(recording.robot_outcome, completed_later=True)
        mcap_records.Metadata(OUTCOME_RECORD, _to_text(msgspec.to_builtins(outcome))).write(end)
    mcap_records.DataEnd(0).write(end)
    mcap_records.Footer(0, 0, 0).write(end)
    with open(path, "r+b") as file:
        file.truncate(read_intact_records(path)[2])
        file.seek(0, os.SEEK_END)
        file.write(end.end() + MCAP0_MAGIC)
        file.flush()
        os.fsync(file.fileno())


def _to_text(values: Mapping[str, Any]) -> dict[str, str]:
    return {name: encode(value).decode() for name, value in values.items()}
