"""Simulated participants whose processes are killed at random instants."""

import os
import random
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

from avrgym.study import live
from avrgym.study.checking import check_study
from avrgym.study.recording import RecordingError, RecordingWriter, read_recording
from avrgym.study.rows import Trial
from avrgym.study.simulation import simulate_participant, simulated_participant
from avrgym.study.store import Store
from avrgym.vr import attendance
from avrgym.vr.plan import SessionPlan

SEED = 5
HEADER_BYTES = 8192
WRITTEN = struct.Struct("<dq")
"""What is noted of each record as it is queued: when, and its time in the trial in nanoseconds."""


@dataclass(frozen=True)
class Loss:
    """What a kill cost: the age of the oldest record that is lost, and how much of the open trial is lost."""

    age_s: float
    trial_s: float


def make_quick() -> None:
    """Let simulated participants waste no time in this process."""
    attendance.CALIBRATION_S = 0.6
    attendance.ANSWER_AFTER_S = 0.05
    plan_session: Callable[[Store, str], SessionPlan] = live.plan_session
    live.plan_session = lambda store, pseudonym: replace(plan_session(store, pseudonym), countdown_s=0.1)


def take_part(folder: Path, pseudonym: str, seed: int, journal: Path) -> None:
    """A quick participant, whose records are noted as they are queued; ends by leaving the process."""
    make_quick()
    _note_records(journal)
    simulate_participant(folder, pseudonym, seed)


def _note_records(journal: Path) -> None:
    """Append to a file beside the recordings what the session hands to their writer."""
    write = RecordingWriter.write

    def noted(self: RecordingWriter, topic: str, log_time_ns: int, record) -> None:
        write(self, topic, log_time_ns, record)
        with open(journal / f"{self.path.parent.name}-{self.path.name}", "ab", buffering=0) as file:
            file.write(WRITTEN.pack(time.monotonic(), log_time_ns))

    RecordingWriter.write = noted


def begin(folder: Path, pseudonym: str, seed: int, journal: Path) -> BaseProcess:
    """Let someone take part in a process of their own, forked from one that has imported what they need."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["avrgym.study.simulation"])
    journal.mkdir(exist_ok=True)
    process = context.Process(target=take_part, args=(folder, pseudonym, seed, journal))
    process.start()
    return process


def run_and_kill(folder: Path, pseudonym: str, seed: int, after_s: float, journal: Path) -> list[Loss]:
    """Kill someone's process after a while, unless it is over before; what that cost the trials that ran."""
    process = begin(folder, pseudonym, seed, journal)
    process.join(after_s)
    killed_s = time.monotonic()
    process.kill()
    process.join()
    return [
        loss for path in (folder / "recordings" / pseudonym).rglob("*.mcap")
        if (loss := _loss(path, journal, killed_s)) is not None
    ]  # fmt: skip


def _loss(path: Path, journal: Path, killed_s: float) -> Loss | None:
    """What of a recording is lost, compared with what was handed to its writer; nothing if that is not known."""
    noted = journal / f"{path.parent.name}-{path.name}"
    if not noted.exists():
        return None
    written = list(
        WRITTEN.iter_unpack(noted.read_bytes()[: noted.stat().st_size // WRITTEN.size * WRITTEN.size])
    )
    noted.unlink()
    try:
        kept = sum(len(records) for records in read_recording(path).topics.values())
    except RecordingError:  # killed before the header was whole
        kept = 0
    if kept >= len(written):
        return Loss(0.0, 0.0)
    (queued_s, lost_from_ns), (_, last_ns) = written[kept], written[-1]
    return Loss(killed_s - queued_s, (last_ns - lost_from_ns) / 1e9)


def outcome_of(store: Store, pseudonym: str) -> list[tuple[Trial, dict, list[tuple[str, int, float]]]]:
    """A participant's completed trials: what was planned, its figures and its answers."""
    answers = store.answers(pseudonym)
    completed = {a.trial: a for a in store.attempts(pseudonym) if a.state == "completed"}
    return [
        (trial, completed[trial.id].figures,
         [(g.item, g.value, g.response_time_s) for g in answers if g.attempt == completed[trial.id].id])
        for trial in store.trials(pseudonym) if trial.id in completed
    ]  # fmt: skip


def kill_until(
    folder: Path, pseudonyms: list[str], seed: int, kills: int, longest_s: float, journal: Path
) -> tuple[int, list[Loss]]:
    """Kill participants at random instants until that has been done so often; then they go on to the end.

    What was completed before each kill must be completed after it, unchanged.

    Returns:
        How often a process was killed, and what each kill cost.
    """
    chance, losses, done = random.Random(seed), [], 0
    with Store(folder) as store:
        for pseudonym in pseudonyms:
            while done < kills and store.participant(pseudonym).state != "completed":
                before = outcome_of(store, pseudonym)
                losses += run_and_kill(folder, pseudonym, seed, chance.uniform(0.0, longest_s), journal)
                done += 1
                assert outcome_of(store, pseudonym)[: len(before)] == before
        for pseudonym in pseudonyms:
            if store.participant(pseudonym).state != "completed":
                finish(folder, pseudonym, seed, journal)
    return done, losses


def compare_with_killed(whole: Path, folder: Path, journal: Path, participants: int, kills: int) -> str:
    """Let the same participants take part in two equal studies, once undisturbed, once killed so often.

    Both studies must be the same in the end, nothing wrong with them, and every file must load.

    Returns:
        What was counted and measured, in words.
    """
    people = _begin_study(whole, participants)
    _begin_study(folder, participants)
    began_s = time.monotonic()
    for pseudonym in people:
        finish(whole, pseudonym, SEED, journal)
    with Store(whole) as store:
        trials = sum(len(store.trials(pseudonym)) for pseudonym in people)
    longest_s = 1.5 * (time.monotonic() - began_s) / trials
    killed, losses = kill_until(folder, people, SEED, kills, longest_s, journal)
    attempts = _assert_same(whole, folder, people)
    for path in folder.rglob("*.mcap"):
        assert_loads(path)
    worst_s = max((loss.age_s for loss in losses), default=0.0)
    assert worst_s < 1.0
    return (
        f"\n{killed} kills, {attempts} attempts at {trials} trials; what was lost of an open trial "
        f"had been queued at most {worst_s:.2f} s before"
    )


def _begin_study(folder: Path, participants: int) -> list[str]:
    with Store(folder) as store:
        return [simulated_participant(store, index, SEED) for index in range(participants)]


def _assert_same(whole: Path, folder: Path, people: list[str]) -> int:
    """How many attempts the study has that was broken off."""
    with Store(folder) as store, Store(whole) as expected:
        for pseudonym in people:
            assert store.participant(pseudonym).state == "completed"
            assert outcome_of(store, pseudonym) == outcome_of(expected, pseudonym)
        assert [f"{each.where}: {each.what}" for each in check_study(store) if each.wrong] == []
        return sum(len(store.attempts(pseudonym)) for pseudonym in people)


def assert_loads(path: Path) -> None:
    """A file reads up to where it was broken off; only one that was killed as it was opened is none yet."""
    try:
        assert read_recording(path).metadata["simulated"]
    except RecordingError:
        assert path.stat().st_size < HEADER_BYTES


def finish(folder: Path, pseudonym: str, seed: int, journal: Path) -> None:
    """Let someone take part to the end."""
    process = begin(folder, pseudonym, seed, journal)
    process.join()
    assert process.exitcode == os.EX_OK
