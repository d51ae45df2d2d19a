"""Simulated participants in processes that are killed at random times."""

import csv
import os
import random
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from datetime import datetime
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import msgspec

from avrgym.recording.reader import RecordingError, read_recording
from avrgym.recording.schema import Metrics, Outcome
from avrgym.recording.writer import RecordingWriter
from avrgym.study.checking.study_checks import check_study
from avrgym.study.export import export_study
from avrgym.study.sessions import study_visit
from avrgym.study.sessions.dry_run import DryRunSettings, find_or_enrol_participant, simulate_participant
from avrgym.study.storage.database_rows import Trial
from avrgym.study.storage.store import StudyStore
from avrgym.vr.emulation import in_process_client
from avrgym.vr.session.plan import SessionPlan

SEED = 5
HEADER_BYTES = 8192
JOURNAL_ENTRY = struct.Struct("<qq")
"""Times of a queued record, ns: in the trial, and on the machine's clock."""


def shorten_delays() -> None:
    """Shorten the delays of simulated participants in this process."""
    in_process_client.CALIBRATION_STILL_TIME_S = 0.6
    in_process_client.ANSWER_DELAY_S = 0.05
    plan_session: Callable[..., SessionPlan] = study_visit.plan_session
    study_visit.plan_session = lambda *given, **how: replace(plan_session(*given, **how), countdown_s=0.1)


def take_part(folder: Path, pseudonym: str, seed: int, journal: Path) -> None:
    """Run a participant's session and log its queued records."""
    shorten_delays()
    _note_records(journal)
    simulate_participant(folder, pseudonym, DryRunSettings(seed))


def _note_records(journal: Path) -> None:
    """Log the times of the records that the session sends to the recording writer."""
    write = RecordingWriter.write

    def noted(self: RecordingWriter, topic: str, log_time_ns: int, record) -> None:
        write(self, topic, log_time_ns, record)
        with open(journal / f"{self.path.parent.name}-{self.path.name}", "ab", buffering=0) as file:
            file.write(JOURNAL_ENTRY.pack(log_time_ns, time.monotonic_ns()))

    RecordingWriter.write = noted


def start_participant(folder: Path, pseudonym: str, seed: int, journal: Path) -> BaseProcess:
    """Run a participant's session in another process."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["avrgym.study.sessions.dry_run"])
    journal.mkdir(exist_ok=True)
    process = context.Process(target=take_part, args=(folder, pseudonym, seed, journal))
    process.start()
    return process


def run_and_kill(folder: Path, pseudonym: str, seed: int, after_s: float, journal: Path) -> float:
    """Kill a participant's process after ``after_s``. Returns the lost seconds of an open trial."""
    process = start_participant(folder, pseudonym, seed, journal)
    process.join(after_s)
    process.kill()
    process.join()
    recordings = (folder / "recordings" / pseudonym).rglob("*.mcap")
    return max((_lost_s(path, journal) for path in recordings), default=0.0)


def _lost_s(path: Path, journal: Path) -> float:
    """Return the seconds of queued records that a recording lacks since the last kill.

    Takes the minimum of trial time and machine time: the simulated clock is not synchronous with the machine's.
    """
    noted = journal / f"{path.parent.name}-{path.name}"
    if not noted.exists():
        return 0.0
    data = noted.read_bytes()
    noted.unlink()
    queued = list(JOURNAL_ENTRY.iter_unpack(data[: len(data) // JOURNAL_ENTRY.size * JOURNAL_ENTRY.size]))
    try:
        stored = sum(len(records) for records in read_recording(path).messages_by_topic.values())
    except RecordingError:  # killed while it wrote the header
        stored = 0
    if stored >= len(queued):
        return 0.0
    return min(last - first for first, last in zip(queued[stored], queued[-1], strict=True)) / 1e9


def completed_results(
    store: StudyStore, pseudonym: str
) -> list[tuple[Trial, Metrics, list[tuple[str, int, float]]]]:
    """Return a participant's completed trials with their metrics and answers."""
    answers = store.read_answers(pseudonym)
    completed = {a.trial: a for a in store.read_attempts(pseudonym) if a.state == "completed"}
    return [
        (trial, completed[trial.id].metrics,
         [(g.item, g.value, g.response_time_s) for g in answers if g.attempt == completed[trial.id].id])
        for trial in store.read_trials(pseudonym) if trial.id in completed
    ]  # fmt: skip


def compare_with_killed(undisturbed: Path, folder: Path, journal: Path, kills: int) -> str:
    """Run the same participants in two equal studies: one undisturbed, one with ``kills`` kills.

    Completed trials stay completed. Both studies are equal in the end and without errors, every file is readable, and
    an open trial loses less than one second. Returns a summary.
    """
    trials = _take_part_undisturbed(undisturbed, 1, journal)
    participants, lost_s = _kill(folder, kills, 1.5 * _first_session_s(undisturbed) / trials, journal)
    trials = _take_part_undisturbed(undisturbed, participants, journal)
    attempts = assert_same(undisturbed, folder)
    for path in folder.rglob("*.mcap"):
        assert_readable(path)
    assert lost_s < 1.0
    return (
        f"\n{kills} kills, {attempts} attempts at {trials} trials; an open trial lost at most {lost_s:.2f} s"
    )


def _first_session_s(folder: Path) -> float:
    """Return the duration of the first participant's session, s."""
    with StudyStore(folder) as store:
        session = store.read_sessions("sub-001")[0]
    assert session.closed_at is not None
    took = datetime.fromisoformat(session.closed_at) - datetime.fromisoformat(session.opened_at)
    return took.total_seconds()


def _kill(folder: Path, kills: int, longest_s: float, journal: Path) -> tuple[int, float]:
    """Kill sessions of participants. Returns the number of participants, and the longest loss of an open trial, s."""
    rng, done, participants, lost_s = random.Random(SEED), 0, 0, 0.0
    with StudyStore(folder) as store:
        while done < kills:
            pseudonym = find_or_enrol_participant(store, participants, DryRunSettings(SEED))
            participants += 1
            while done < kills and store.read_participant(pseudonym).state != "completed":
                before = completed_results(store, pseudonym)
                after_s = rng.uniform(0.0, longest_s)
                lost_s = max(lost_s, run_and_kill(folder, pseudonym, SEED, after_s, journal))
                done += 1
                assert completed_results(store, pseudonym)[: len(before)] == before
        _finish_all(folder, store, journal)
    return participants, lost_s


def _take_part_undisturbed(folder: Path, participants: int, journal: Path) -> int:
    """Run participants without kills. Returns their number of trials."""
    with StudyStore(folder) as store:
        pseudonyms = [
            find_or_enrol_participant(store, index, DryRunSettings(SEED)) for index in range(participants)
        ]
        _finish_all(folder, store, journal)
        return sum(len(store.read_trials(pseudonym)) for pseudonym in pseudonyms)


def _finish_all(folder: Path, store: StudyStore, journal: Path) -> None:
    for person in store.read_participants():
        if person.state != "completed":
            finish(folder, person.pseudonym, SEED, journal)


def assert_same(undisturbed: Path, folder: Path) -> int:
    """Assert that two studies have equal results. Returns the number of attempts of the second, killed study."""
    with StudyStore(folder) as store, StudyStore(undisturbed) as expected:
        pseudonyms = [person.pseudonym for person in store.read_participants()]
        for pseudonym in pseudonyms:
            assert store.read_participant(pseudonym).state == "completed"
            assert completed_results(store, pseudonym) == completed_results(expected, pseudonym)
            for recorded, wanted in zip(
                recorded_contents(store, pseudonym), recorded_contents(expected, pseudonym), strict=True
            ):
                assert recorded == wanted
        assert exported_tables(store) == exported_tables(expected)
        assert [f"{each.where}: {each.message}" for each in check_study(store) if each.is_error] == []
        return sum(len(store.read_attempts(pseudonym)) for pseudonym in pseudonyms)


def recorded_contents(
    store: StudyStore, pseudonym: str
) -> Iterator[tuple[dict[str, Any], Outcome | None, list]]:
    """Yield the recordings of a participant's completed trials, without what depends on the run."""
    completed = {a.trial: a for a in store.read_attempts(pseudonym) if a.state == "completed"}
    for trial in store.read_trials(pseudonym):
        recording = read_recording(store.resolve_path(completed[trial.id].recording))
        values = msgspec.to_builtins(recording.configuration)
        configuration = {name: value for name, value in values.items() if name not in RUN_COLUMNS}
        configuration["consent"] = {
            name: value for name, value in values["consent"].items() if name not in RUN_COLUMNS
        }
        messages = [
            message
            for message in recording.messages
            if getattr(message[2], "name", "") != "recording_stalled"
        ]
        yield configuration, recording.outcome, messages


RUN_COLUMNS = {
    "session",
    "attempt",
    "attempts",
    "recording",
    "sha256",
    "consented_at",
    "started_at",
    "ended_at",
    "answered_at",
    "decided_at",
    "at",
}
"""Columns that depend on the run of a study."""
LOG_TABLES = {"events.csv", "log.csv"}
"""Tables to which a killed run adds rows."""


def exported_tables(store: StudyStore) -> dict[str, list[dict[str, str]]]:
    """Return the rows of the exported tables, without logs and incomplete attempts."""
    with TemporaryDirectory() as folder:
        export_study(store, "csv", Path(folder) / "tables")
        paths = (Path(folder) / "tables").glob("*.csv")
        tables = {path.name: _rows(path) for path in paths if path.name not in LOG_TABLES}
    completed = {_attempt(row) for row in tables["attempts.csv"] if row["state"] == "completed"}
    return {
        name: [
            {column: value for column, value in row.items() if column not in RUN_COLUMNS}
            for row in rows
            if not row.get("attempt") or _attempt(row) in completed
        ]
        for name, rows in tables.items()
    }


def _rows(table: Path) -> list[dict[str, str]]:
    with open(table, encoding="utf-8-sig", newline="") as file:
        return list(csv.DictReader(file))


def _attempt(row: dict[str, str]) -> tuple[str, str, str]:
    return row["participant"], row["position"], row["attempt"]


def assert_readable(path: Path) -> None:
    """Assert that a recording is readable, or that it was killed while it wrote the header."""
    try:
        assert read_recording(path).configuration.simulated
    except RecordingError:
        assert path.stat().st_size < HEADER_BYTES


def finish(folder: Path, pseudonym: str, seed: int, journal: Path) -> None:
    """Run a participant's session to the end."""
    process = start_participant(folder, pseudonym, seed, journal)
    process.join()
    assert process.exitcode == os.EX_OK
