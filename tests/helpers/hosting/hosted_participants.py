"""Hosts a study for emulated participants, kills the processes of sessions, and returns figures."""

import asyncio
import multiprocessing
import os
import random
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path
from typing import Any

from avrgym.hosting.computers import Computer
from avrgym.hosting.host import StudyHost
from avrgym.hosting.session_pool import HostedSession, SessionPool
from avrgym.study.checking.study_checks import check_study
from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.store import StudyStore
from helpers.hosting.emulated_participants import (
    DEFAULT_COURSES,
    Course,
    percentile_ms,
    record_motion,
    take_part_together,
)
from helpers.studies.small_studies import make_study

DEADLINE_S = 1800.0
DESIGN = {
    "tasks": '["Feeding"]',
    "robots": '["Jaco"]',
    "trial_steps": "60",
    "free_movement_s": "1.0",
}
SETTINGS = 'headset_check = false\nabsence_minutes = 2\n[completed]\ncode = "DONE"\n'


def host_participants(
    folder: Path,
    participants: int,
    kills: int,
    computers: Callable[[StudyStore], Callable[[], Sequence[Computer]] | None] = lambda store: None,
    kill: Callable[[HostedSession], object] = lambda session: os.kill(
        session.process.pid or 0, signal.SIGKILL
    ),
    **changes: str,
) -> dict[str, Any]:
    """Host a study for emulated participants that start together. Returns figures about them.

    ``computers``: returns the computers that run sessions, see ``StudyHost``. ``kill``: ends the process of a session.
    ``changes``: changed values of the design, in TOML syntax.
    """
    make_study(folder, **DESIGN | changes)
    (folder / "host.toml").write_text(SETTINGS)
    with StudyStore(folder) as store, StudyHost(store, computers=computers(store)) as host:
        invitations = [each.token for each in create_invitations(store, [""] * participants, days=1)]
        watch = _Watch(host.pool, kills, kill)
        watch.start()
        began_s = time.monotonic()
        outcomes = take_part_in_other_process(host.public_url, invitations)
        seconds = time.monotonic() - began_s
        watch.over.set()
        watch.join()
        return figures(store, outcomes, watch.counts) | {
            "seconds": round(seconds, 1),
            "killed": watch.killed,
        }


def figures(store: StudyStore, outcomes: list[dict[str, Any]], counts: "Counts") -> dict[str, Any]:
    """Returns figures about a hosted study. ``outcomes``: of its participants."""
    faults = [str(each) for each in check_study(store) if each.is_error]
    faults += [str(each) for each in store.database.find_integrity_errors()]
    trials = [trial for each in store.read_participants() for trial in store.read_trials(each.pseudonym)]
    attempts = [each for one in store.read_participants() for each in store.read_attempts(one.pseudonym)]
    return {
        "participants": len(outcomes),
        "completed": sum(each["ending"] == "completed" for each in outcomes),
        "with_code": sum(each["code"] == "DONE" for each in outcomes),
        "resumed": sum(each["ending"] == "completed" and each["connections"] > 1 for each in outcomes),
        "errors": [each["error"] for each in outcomes if each["error"]],
        "load": round(os.getloadavg()[1], 1),
        "most_sessions_at_once": counts.most,
        "connections": sum(each["connections"] for each in outcomes),
        "trials": len(trials),
        "lost_trials": sum(trial.state != "completed" for trial in trials),
        "attempts": dict(Counter(each.state for each in attempts)),
        "cpu_share_in_trials": round(counts.mean_cpu_share, 3),
        "ticks_given_up_share": round(counts.missed / max(counts.ticks, 1), 5),
        "round_trip_ms": {str(each["name"]): each["ms"] for each in outcomes[0]["percentiles"]},
        "waited_s_max": max(each["waited_s"] for each in outcomes),
        "faults": faults,
    }


def take_part_in_other_process(
    origin: str, invitations: list[str], courses: Sequence[Course] = DEFAULT_COURSES
) -> list[dict[str, Any]]:
    """Let participants take part at the same time, in another process. Returns their outcomes."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_take_part, (origin, invitations, courses))


def _take_part(origin: str, invitations: list[str], courses: Sequence[Course]) -> list[dict[str, Any]]:
    outcomes = asyncio.run(take_part_together(origin, invitations, DEADLINE_S, record_motion(), courses))
    shares = {"p50": 0.5, "p95": 0.95, "p99": 0.99}
    percentiles = [
        {"name": name, "ms": round(percentile_ms(outcomes, share), 1)} for name, share in shares.items()
    ]
    return [
        {
            "ending": each.ending,
            "code": each.code,
            "connections": each.connections,
            "waited_s": each.waited_s,
            "error": each.error,
            "received_bytes": each.received_bytes,
            "sent_bytes": each.sent_bytes,
            "percentiles": percentiles,
        }
        for each in outcomes
    ]


class Counts:
    """Counts of sessions and ticks. ``most``: the largest number of concurrent sessions."""

    def __init__(self) -> None:
        self.most = 0
        self._last: dict[Hashable, tuple[float, int]] = {}
        self._shares: list[float] = []

    def count(
        self, process: Hashable, seconds: float, missed_ticks: int, cpu_share: float, *, in_trial: bool
    ) -> None:
        """Count the latest report of a session's process."""
        self._last[process] = seconds, missed_ticks
        if in_trial:
            self._shares.append(cpu_share)

    @property
    def ticks(self) -> float:
        """Number of ticks of all processes."""
        return sum(100.0 * seconds for seconds, _ in self._last.values())

    @property
    def missed(self) -> int:
        """Number of ticks that all processes gave up."""
        return sum(missed for _, missed in self._last.values())

    @property
    def mean_cpu_share(self) -> float:
        """Mean processor time of a session in trials, as a share of one core."""
        return sum(self._shares) / max(len(self._shares), 1)


class _Watch(threading.Thread):
    """Counts sessions and ticks, and kills processes of sessions."""

    def __init__(self, pool: SessionPool, kills: int, kill: Callable[[HostedSession], object]) -> None:
        super().__init__(daemon=True)
        self.over = threading.Event()
        self.counts, self.killed = Counts(), 0
        self._pool, self._kills, self._kill = pool, kills, kill
        self._random = random.Random(1)

    def run(self) -> None:
        """Watch until the end."""
        next_kill_s = time.monotonic() + 15.0
        while not self.over.wait(1.0):
            sessions = self._pool.sessions
            self.counts.most = max(self.counts.most, len(sessions))
            for each in sessions:
                report = each.report
                self.counts.count(
                    each.process.pid,
                    report.elapsed_s,
                    report.missed_ticks,
                    report.cpu_load,
                    in_trial=report.phase == "trial",
                )
            busy = [each for each in sessions if each.report.phase in ("trial", "free", "questionnaire")]
            if self.killed < self._kills and busy and time.monotonic() > next_kill_s:
                self._kill(self._random.choice(busy))
                self.killed += 1
                next_kill_s = time.monotonic() + 5.0
