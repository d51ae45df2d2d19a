"""Number of sessions that this computer can run, from the processor time that the running sessions use.

A session uses most in trials; only this time is measured. The estimate for one session is therefore the mean of the
sessions' highest shares over ``MEAN_REPORTS`` reports. A new session is admitted only if the sum stays below the limit,
if the sessions give up at most ``MAX_MISSED_SHARE`` of their ticks, and if the processors are idle for the time
that a session needs. Other programs thus count too.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

MAX_MISSED_SHARE = 0.005
"""Maximum share of ticks given up in the last ``WINDOW_S`` at which a session is admitted."""
MAX_LOAD = 0.8
"""Maximum load by sessions, as a share of all cores. The rest is for the host and the database."""
INITIAL_CPU_SHARE = 0.35
"""Processor time of a session as a share of one core, before it is measured."""
WINDOW_S = 30.0
MEAN_REPORTS = 10
YOUNG_S = 20.0
IDLE_WINDOW_S = 5.0
"""Time over which the idle cores are measured. It must contain the start of the previous session."""
SETTLE_S = 5.0
"""The start of a session builds models; its processor time is not counted."""


@dataclass
class _Measured:
    peak: float = 0.0
    recent: deque[float] = field(default_factory=lambda: deque[float](maxlen=MEAN_REPORTS))
    missed: deque[tuple[float, int]] = field(default_factory=deque[tuple[float, int]])


class IdleCores:
    """Measures how many cores were idle in the last ``IDLE_WINDOW_S``, from Linux's ``/proc/stat`` (proc(5))."""

    def __init__(self, path: Path = Path("/proc/stat"), clock: Callable[[], float] = time.monotonic) -> None:
        self._path, self._clock = path, clock
        self._samples: deque[tuple[float, int, int]] = deque()

    def measure(self) -> float | None:
        """Returns the mean number of idle cores; ``None`` if it is unknown."""
        try:
            lines = self._path.read_text().splitlines()
        except OSError:
            return None
        times = [int(each) for each in lines[0].split()[1:9]]
        cores = sum(line.startswith("cpu") for line in lines) - 1
        now_s = self._clock()
        self._samples.append((now_s, times[3], sum(times)))
        while now_s - self._samples[0][0] > IDLE_WINDOW_S:
            self._samples.popleft()
        (_, idle_before, before), (_, idle, after) = self._samples[0], self._samples[-1]
        return cores * (idle - idle_before) / (after - before) if after > before else None


class Capacity:
    """Measures the running sessions and decides whether another one can start."""

    def __init__(self, max_sessions: int | None = None, cores: int | None = None) -> None:
        """``max_sessions``: a limit in addition to the measured one. ``cores``: default: those of this process."""
        self._max_sessions = max_sessions
        self._cores = cores or _own_cores()
        self._running: dict[str, _Measured] = {}
        self._finished_peaks: deque[float] = deque(maxlen=20)
        self.idle_cores: float | None = None
        """Idle cores of this computer, if they are measured."""

    @property
    def cpu_share(self) -> float:
        """Estimated processor time of one session, as a share of one core."""
        peaks = [each.peak for each in self._running.values() if each.peak > 0.0]
        known = [*self._finished_peaks, *peaks]
        return sum(known) / len(known) if known else INITIAL_CPU_SHARE

    @property
    def sessions(self) -> int:
        """Number of sessions that can run concurrently; at least 1."""
        measured = max(1, int(MAX_LOAD * self._cores / max(self.cpu_share, 0.01)))
        return measured if self._max_sessions is None else min(measured, self._max_sessions)

    @property
    def missed_share(self) -> float:
        """Share of the ticks that all sessions gave up in the last ``WINDOW_S``."""
        missed = planned = 0.0
        for each in self._running.values():
            if len(each.missed) > 1:
                (first_s, first), (last_s, last) = each.missed[0], each.missed[-1]
                missed += last - first
                planned += 100.0 * (last_s - first_s)
        return missed / planned if planned else 0.0

    def observe(
        self, session: str, seconds: float, cpu_share: float, missed_ticks: int, *, in_trial: bool
    ) -> None:
        """Store a report of a session: time since its start, processor time and ticks given up.

        ``in_trial``: the processor time is that of a trial, and counts.
        """
        own = self._running.setdefault(session, _Measured())
        if seconds > SETTLE_S:
            if in_trial:
                own.recent.append(cpu_share)
            if len(own.recent) == MEAN_REPORTS:
                own.peak = max(own.peak, sum(own.recent) / MEAN_REPORTS)
            own.missed.append((seconds, missed_ticks))
            while seconds - own.missed[0][0] > WINDOW_S:
                own.missed.popleft()

    def forget(self, session: str) -> None:
        """Remove a session that has ended."""
        own = self._running.pop(session, None)
        if own is not None and own.peak > 0.0:
            self._finished_peaks.append(own.peak)

    def admits(self, running: int, young: int = 0) -> bool:
        """Returns whether one more session can start.

        ``running``: number of running sessions. ``young``: number of those that began in the last ``YOUNG_S``. They do
        not use their full processor time yet.
        """
        if running == 0:
            return True
        is_idle = self.idle_cores is None or self.idle_cores >= (1 + young) * self.cpu_share
        return running < self.sessions and is_idle and self.missed_share <= MAX_MISSED_SHARE


def _own_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
