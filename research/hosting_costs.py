"""Measures what a hosted session uses, and computes costs and limits: python research/hosting_costs.py [PARTICIPANTS].

One host, SQLite, emulated participants at 90 Hz one after another. Prices are assumptions; change them below.
"""

import asyncio
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from statistics import fmean
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.store import Store, record_event
from helpers.hosting.emulated_participants import EmulatedParticipant, Outcome, record_motion
from helpers.hosting.served_host import host_process
from helpers.studies.small_studies import make_study

DESIGN = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "free_movement_s": "2.0"}
PARTICIPANTS_PER_DAY = 10_000
HOURS_PER_DAY, PEAK_FACTOR = 16.0, 2.0
"""Hours in which participants come, and the ratio of the busiest hour to the mean."""
SESSION_H = 0.75
MAX_LOAD = 0.8
EUR_PER_CORE_H, EUR_PER_GB_H, EUR_PER_TRAFFIC_GB = 0.03, 0.004, 0.01
"""Assumed prices of a rented core, of memory and of traffic to the internet."""


def measure(folder: Path, participants: int) -> dict[str, float]:
    """Returns mean figures of one session, and of the host per session."""
    make_study(folder, **DESIGN)
    (folder / "host.toml").write_text("headset_check = false\n")
    with Store(folder) as store, host_process(store, "--sessions", "1") as (host, served):
        tokens = [each.token for each in create_invitations(store, [""] * participants, days=1)]
        meter = _Meter(store, host.process.pid)
        meter.start()
        outcomes = [_take_part(served.url(""), token) for token in tokens]
        meter.over.set()
        meter.join()
        rows = store.database.chain_head().number
        began = time.perf_counter()
        for _ in range(200):
            with store.write_transaction() as connection:
                record_event(connection, "measured", "", {})
        write_s = (time.perf_counter() - began) / 200
        seconds = meter.session_s
        recorded = sum(path.stat().st_size for path in folder.rglob("*.mcap"))
        assert [each.ending for each in outcomes] == ["completed"] * participants, outcomes
        return {
            "sessions": participants,
            "seconds": seconds / participants,
            "session_cores": meter.session_cpu_s / seconds,
            "host_cores": meter.host_cpu_s / seconds,
            "session_memory_mb": fmean(meter.memory_mb),
            "download_mbit_s": 8e-6 * sum(each.received_bytes for each in outcomes) / seconds,
            "upload_mbit_s": 8e-6 * sum(each.sent_bytes for each in outcomes) / seconds,
            "recorded_mb_h": 3.6e-3 * recorded / seconds,
            "rows_per_s": rows / seconds,
            "write_transaction_ms": 1000.0 * write_s,
            "load": os.getloadavg()[0],
        }


def _take_part(origin: str, token: str) -> Outcome:
    return asyncio.run(EmulatedParticipant(origin, token, record_motion()).take_part(1800.0))


class _Meter(threading.Thread):
    """Adds up the processor time of sessions and host, and the time in which a session runs."""

    def __init__(self, store: Store, host: int) -> None:
        super().__init__(daemon=True)
        self.over = threading.Event()
        self.session_s = self.session_cpu_s = self.host_cpu_s = 0.0
        self.memory_mb: list[float] = []
        self._store, self._host = store, host

    def run(self) -> None:
        """Measure until the end."""
        before = {self._host: _cpu_s(self._host)}
        at_s = time.monotonic()
        while not self.over.wait(1.0):
            now_s = time.monotonic()
            sessions = [
                each for one in self._store.participants() for each in self._store.sessions(one.pseudonym)
            ]
            running = [each.process for each in sessions if each.state == "open"]
            now = {each: _cpu_s(each) for each in (self._host, *running)}
            if running and running[0] in before:
                self.session_s += now_s - at_s
                self.session_cpu_s += now[running[0]] - before[running[0]]
                self.host_cpu_s += now[self._host] - before[self._host]
                self.memory_mb.append(_memory_mb(running[0]))
            before, at_s = now, now_s


def _cpu_s(process: int) -> float:
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_mb(process: int) -> float:
    """Proportional set size: shared pages count in part."""
    try:
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0.0
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1000.0


def compute(measured: dict[str, float]) -> dict[str, Any]:
    """Returns costs per participant-hour, and needs and limits at ``PARTICIPANTS_PER_DAY``."""
    cores = (measured["session_cores"] + measured["host_cores"]) / MAX_LOAD
    memory_gb = measured["session_memory_mb"] / 1000.0
    traffic_gb_h = measured["download_mbit_s"] * 3600.0 / 8000.0
    costs = {
        "processor": cores * EUR_PER_CORE_H,
        "memory": memory_gb * EUR_PER_GB_H,
        "traffic": traffic_gb_h * EUR_PER_TRAFFIC_GB,
    }
    mean = PARTICIPANTS_PER_DAY * SESSION_H / HOURS_PER_DAY
    peak = PEAK_FACTOR * mean
    return {
        "eur_per_participant_h": costs | {"sum": sum(costs.values())},
        "sessions_per_core": MAX_LOAD / measured["session_cores"],
        "sessions_mean": mean,
        "sessions_peak": peak,
        "peak": {
            "cores_of_sessions": peak * measured["session_cores"] / MAX_LOAD,
            "memory_gb": peak * memory_gb,
            "download_gbit_s": peak * measured["download_mbit_s"] / 1000.0,
            "rows_per_s": peak * measured["rows_per_s"],
            "recordings_tb_per_day": PARTICIPANTS_PER_DAY * SESSION_H * measured["recorded_mb_h"] / 1e6,
        },
        "sessions_until_saturation": {
            "one host process (its event loop uses one core)": MAX_LOAD / measured["host_cores"],
            "one database (one writer)": 1000.0 / measured["write_transaction_ms"] / measured["rows_per_s"],
            "link of 1 Gbit/s": 1000.0 / measured["download_mbit_s"],
            "machine of 64 cores": 64.0 * MAX_LOAD / (measured["session_cores"] + measured["host_cores"]),
        },
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        figures = measure(Path(temporary) / "study", int((*sys.argv[1:], "2")[0]))
    print(json.dumps({"measured": figures, "computed": compute(figures)}, indent=2))
