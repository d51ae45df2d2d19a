"""Number of sessions that this computer can run, estimated from the processor time of the running sessions.

A session needs most processor time in trials, and only trials are measured. The measured load of a session is its
largest mean over ``AVERAGED_REPORT_COUNT`` reports. The estimate for a new session is the mean over all measured
sessions.

A new session is admitted if three conditions hold. The estimated load of all sessions is at most ``MAX_CPU_LOAD``. The
sessions miss at most ``MAX_MISSED_TICK_FRACTION`` of their ticks. Enough cores are idle; this includes the load of
other programs.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

MAX_MISSED_TICK_FRACTION = 0.005
"""Maximum share of missed ticks at which a session is admitted, measured over the last ``MISSED_TICK_WINDOW_S``."""
MAX_CPU_LOAD = 0.8
"""Maximum load by sessions, as a share of all cores. The rest is for the host and the database."""
INITIAL_SESSION_CPU_LOAD = 0.35
"""Assumed load of a session before the first measurement, as a share of one core."""
MISSED_TICK_WINDOW_S = 30.0
"""Time in seconds over which missed ticks are counted."""
AVERAGED_REPORT_COUNT = 10
"""Number of reports (one each second) in a mean of the load."""
WARM_UP_DURATION_S = 20.0
"""Time in seconds after its start in which a session does not yet use its full processor time."""
IDLE_CORE_WINDOW_S = 5.0
"""Time in seconds over which the idle cores are measured. It must contain the start of the previous session."""
IGNORED_STARTUP_DURATION_S = 5.0
"""Time in seconds after the start of a session in which its load is not measured. The session then builds its models.
"""


@dataclass
class _Measured:
    peak: float = 0.0
    recent: deque[float] = field(default_factory=lambda: deque[float](maxlen=AVERAGED_REPORT_COUNT))
    missed: deque[tuple[float, int]] = field(default_factory=deque[tuple[float, int]])
    idle_cores: float | None = None


class IdleCoreMonitor:
    """Measures the number of idle cores over the last ``IDLE_CORE_WINDOW_S``, from Linux's ``/proc/stat`` (proc(5))."""

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
        while now_s - self._samples[0][0] > IDLE_CORE_WINDOW_S:
            self._samples.popleft()
        (_, idle_before, before), (_, idle, after) = self._samples[0], self._samples[-1]
        return cores * (idle - idle_before) / (after - before) if after > before else None


class SessionCapacity:
    """Measures the load of a computer's sessions, and decides whether another session can start there."""

    def __init__(self, cores: int | None = None) -> None:
        """``cores``: number of cores; default: those of this process."""
        self._cores = cores or _own_cores()
        self._running: dict[str, _Measured] = {}
        self._finished_peaks: deque[float] = deque(maxlen=20)

    @property
    def idle_cores(self) -> float | None:
        """Lowest reported number of idle cores; ``None`` if it is not measured."""
        known = [each.idle_cores for each in self._running.values() if each.idle_cores is not None]
        return min(known, default=None)

    @property
    def session_cpu_load(self) -> float:
        """Estimated load of one session, as a share of one core."""
        peaks = [each.peak for each in self._running.values() if each.peak > 0.0]
        known = [*self._finished_peaks, *peaks]
        return sum(known) / len(known) if known else INITIAL_SESSION_CPU_LOAD

    @property
    def max_sessions(self) -> int:
        """Maximum number of concurrent sessions; at least 1."""
        return max(1, int(MAX_CPU_LOAD * self._cores / max(self.session_cpu_load, 0.01)))

    @property
    def missed_tick_fraction(self) -> float:
        """Share of missed ticks (0 to 1) of all sessions in the last ``MISSED_TICK_WINDOW_S``."""
        missed = planned = 0.0
        for each in self._running.values():
            if len(each.missed) > 1:
                (first_s, first), (last_s, last) = each.missed[0], each.missed[-1]
                missed += last - first
                planned += 100.0 * (last_s - first_s)
        return missed / planned if planned else 0.0

    def add_session_report(
        self,
        session: str,
        seconds: float,
        cpu_share: float,
        missed_ticks: int,
        *,
        in_trial: bool,
        idle_cores: float | None = None,
    ) -> None:
        """Store a report of a session.

        ``seconds``: time since the session's start. ``cpu_share``: load as a share of one core. ``missed_ticks``:
        number of missed ticks so far. ``in_trial``: a trial is running; the load is measured only then. ``idle_cores``:
        number of idle cores of the computer.
        """
        own = self._running.setdefault(session, _Measured())
        own.idle_cores = idle_cores
        if seconds > IGNORED_STARTUP_DURATION_S:
            if in_trial:
                own.recent.append(cpu_share)
            if len(own.recent) == AVERAGED_REPORT_COUNT:
                own.peak = max(own.peak, sum(own.recent) / AVERAGED_REPORT_COUNT)
            own.missed.append((seconds, missed_ticks))
            while seconds - own.missed[0][0] > MISSED_TICK_WINDOW_S:
                own.missed.popleft()

    def remove_session(self, session: str) -> None:
        """Remove an ended session. Its load remains part of the estimate."""
        own = self._running.pop(session, None)
        if own is not None and own.peak > 0.0:
            self._finished_peaks.append(own.peak)

    def can_start_session(self, running: int, young: int = 0) -> bool:
        """Returns whether one more session can start.

        ``running``: number of running sessions. ``young``: number of sessions that started in the last
        ``WARM_UP_DURATION_S``.
        """
        if running == 0:
            return True
        is_idle = self.idle_cores is None or self.idle_cores >= (1 + young) * self.session_cpu_load
        return (
            running < self.max_sessions and is_idle and self.missed_tick_fraction <= MAX_MISSED_TICK_FRACTION
        )


def _own_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
