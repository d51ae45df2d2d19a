"""Costs of a hosted study: measured use of processors, memory, network and database, and what it means at scale.

    PYTHONPATH=tests python research/hosting_costs.py measure PARTICIPANTS   # writes hosting_costs.json
    PYTHONPATH=tests python research/hosting_costs.py compute                # prints the tables

``measure`` hosts a study with PostgreSQL for emulated participants. The computer must be idle. The processor time of
each process is from Linux's ``/proc`` (proc(5)). ``compute`` assumes the prices and the study in the constants below.
"""

import json
import os
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import psycopg

from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.database import DATABASE_URL_VARIABLE
from avrgym.study.storage.store import StudyStore
from helpers.hosting.hosted_participants import SETTINGS, take_part_in_other_process
from helpers.hosting.served_host import Served, host_process
from helpers.studies.small_studies import (
    make_study,
    new_postgresql_database,
    postgresql_data,
    postgresql_process,
    postgresql_programs,
)

FILE = Path(__file__).with_suffix(".json")
DESIGN = {"tasks": '["Feeding"]', "robots": '["Jaco"]', "trial_steps": "200", "free_movement_s": "2.0"}
"""Two trials and one practice trial of 20 s."""
TICKS_PER_S = os.sysconf("SC_CLK_TCK")

SESSION_MIN = 45.0
"""Duration of a session with the paper's 16 trials and their questions."""
PARTICIPANTS_PER_DAY, ACTIVE_HOURS, PEAK_FACTOR = 10_000, 16.0, 2.0
"""Participants come in the active hours of a day. In the busiest hour, they are ``PEAK_FACTOR`` times the mean."""
MAX_LOAD = 0.8
CORES_PER_NODE, LINK_GBIT, CONNECTIONS = 16, 1.0, 400
PRICE_CORE_HOUR, PRICE_GB_SENT, PRICE_GB_MONTH = 0.05, 0.09, 0.023
"""Assumed prices (USD) of a rented core with 4 GB of memory, of sent data, and of an object store."""


class Processes:
    """Processor time and memory of processes and their descendants, from ``/proc``."""

    def __init__(self) -> None:
        self._children: dict[int, list[int]] = defaultdict(list)
        self._used_s: dict[int, float] = {}
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
                self._children[int(fields[1])].append(int(folder.name))
                self._used_s[int(folder.name)] = sum(map(int, fields[11:13])) / TICKS_PER_S

    def below(self, process: int) -> list[int]:
        """Ids of all descendants of a process."""
        found = list(self._children[process])
        return found + [each for one in found for each in self.below(one)]

    def used_s(self, processes: list[int]) -> dict[int, float]:
        """Processor time (s) of each process without its children."""
        return {each: self._used_s.get(each, 0.0) for each in processes}


def memory_mb(process: int) -> float:
    """Proportional share of memory (MB) of a process."""
    with suppress(OSError, StopIteration):
        lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1000.0
    return 0.0


def measure(participants: int) -> dict[str, float]:
    """Host a study for emulated participants. Returns measured figures, most of them for a second of a session."""
    programs = postgresql_programs()
    assert programs is not None, "PostgreSQL's server is not installed"
    with (
        tempfile.TemporaryDirectory() as temporary,
        postgresql_data(programs) as folder,
        postgresql_process(programs, folder) as server,
    ):
        os.environ[DATABASE_URL_VARIABLE] = url = new_postgresql_database(folder)
        study = make_study(Path(temporary) / "study", **DESIGN)
        (study / "host.toml").write_text(SETTINGS)
        with (
            StudyStore(study) as store,
            host_process(store) as (host, served),
            psycopg.connect(url, autocommit=True) as database,
            ThreadPoolExecutor(1) as other,
        ):
            invitations = [each.token for each in create_invitations(store, [""] * participants, days=1)]
            people = other.submit(take_part_in_other_process, f"http://localhost:{host.port}", invitations)
            samples = _Samples(host.process.pid, server.pid, served, database)
            while not people.done():
                time.sleep(1.0)
                samples.add()
            outcomes = people.result()
            recorded = sum(
                each.stat().st_size for each in (study / "recordings").rglob("*") if each.is_file()
            )
            return samples.figures(outcomes) | {"recording_mb_per_trial": recorded / 1e6 / (3 * participants)}


class _Samples:
    """Samples of one measurement, once a second while sessions run."""

    def __init__(self, host: int, postgresql: int, served: Served, database: Any) -> None:
        self._host, self._postgresql, self._served, self._database = host, postgresql, served, database
        self._used_s: dict[str, dict[int, float]] = {"host": {}, "sessions": {}, "postgresql": {}}
        self._starts_s: dict[str, float] = {}
        self._seconds: dict[str, float] = {}
        self._shares: list[float] = []
        self._memory_mb: dict[int, float] = {}
        self._missed = self._most = self._connections = 0
        self._transactions: list[int] = []

    def add(self) -> None:
        """Add a sample."""
        processes = Processes()
        groups = {
            "host": [self._host],
            "sessions": processes.below(self._host),
            "postgresql": [self._postgresql, *processes.below(self._postgresql)],
        }
        for name, group in groups.items():
            self._used_s[name] |= processes.used_s(group)
            self._starts_s.setdefault(name, sum(self._used_s[name].values()))
        with suppress(httpx.HTTPError, KeyError):
            self._add_sessions(groups["sessions"])
        (commits,) = self._database.execute("SELECT sum(xact_commit) FROM pg_stat_database").fetchone()
        self._transactions.append(int(commits))
        (connections,) = self._database.execute(
            "SELECT count(*) FROM pg_stat_activity WHERE datname IS NOT NULL"
        ).fetchone()
        self._connections = max(self._connections, connections - 1)

    def _add_sessions(self, processes: list[int]) -> None:
        token = self._served.host.tokens.experimenter
        sessions = self._served.request("GET", "/api/sessions", token, experimenter=True).json()["sessions"]
        self._most = max(self._most, len(sessions))
        for each in sessions:
            self._seconds[each["id"]] = 60.0 * each["minutes"]
            if each["phase"] == "trial":
                self._shares.append(each["cpu_share"])
        if sessions:
            self._memory_mb[len(sessions)] = sum(map(memory_mb, processes)) / len(sessions)

    def figures(self, outcomes: list[dict[str, Any]]) -> dict[str, float]:
        """Figures of the measurement."""
        seconds = sum(self._seconds.values())
        used_s = {name: sum(each.values()) - self._starts_s[name] for name, each in self._used_s.items()}
        return {
            "participants": len(outcomes),
            "completed": sum(each["ending"] == "completed" for each in outcomes),
            "most_sessions": self._most,
            "session_seconds": seconds,
            "session_cores_in_trials": sum(self._shares) / len(self._shares),
            "session_cores": used_s["sessions"] / seconds,
            "host_cores_per_session": used_s["host"] / seconds,
            "postgresql_cores_per_session": used_s["postgresql"] / seconds,
            "session_memory_mb": self._memory_mb[self._most],
            "received_kbit_per_s": 8e-3 * sum(each["received_bytes"] for each in outcomes) / seconds,
            "sent_kbit_per_s": 8e-3 * sum(each["sent_bytes"] for each in outcomes) / seconds,
            "transactions_per_s": (self._transactions[-1] - self._transactions[0]) / seconds,
            "connections_per_session": self._connections / self._most,
        }


def print_costs(measured: dict[str, float]) -> None:
    """Print the cost of a participant-hour, and what 10 000 participants a day need."""
    for name, value in measured.items():
        print(f"{name:<32}{value:.4g}")
    cores = (
        measured["session_cores"]
        + measured["host_cores_per_session"]
        + measured["postgresql_cores_per_session"]
    )
    gigabytes = measured["received_kbit_per_s"] * 3600.0 / 8e6
    stored = measured["recording_mb_per_trial"] * 16 / (SESSION_MIN / 60.0) / 1000.0
    costs = {
        "cores": cores / MAX_LOAD * PRICE_CORE_HOUR,
        "sent data": gigabytes * PRICE_GB_SENT,
        "storage for a month": stored * PRICE_GB_MONTH,
    }
    print("\nUSD per participant-hour")
    for name, cost in costs.items():
        print(f"{name:<32}{cost:.4f}")
    print(f"{'sum':<32}{sum(costs.values()):.4f}")
    peak = PARTICIPANTS_PER_DAY * SESSION_MIN / 60.0 / ACTIVE_HOURS * PEAK_FACTOR
    print(f"\n{PARTICIPANTS_PER_DAY} participants a day: {peak:.0f} sessions at the same time")
    limits = {
        f"a node of {CORES_PER_NODE} cores": MAX_LOAD * CORES_PER_NODE / measured["session_cores_in_trials"],
        "the event loop of a host (1 core)": MAX_LOAD / measured["host_cores_per_session"],
        f"PostgreSQL: {CONNECTIONS} connections": CONNECTIONS / measured["connections_per_session"],
        "PostgreSQL: 4 cores": 4 * MAX_LOAD / measured["postgresql_cores_per_session"],
        f"a link of {LINK_GBIT:g} Gbit/s": MAX_LOAD * LINK_GBIT * 1e6 / measured["received_kbit_per_s"],
    }
    print(f"{'part':<36}{'sessions':>10}{'needed':>10}")
    for name, limit in sorted(limits.items(), key=lambda each: each[1]):
        print(f"{name:<36}{limit:>10.0f}{peak / limit:>10.1f}")


if __name__ == "__main__":
    if sys.argv[1] == "measure":
        FILE.write_text(json.dumps(measure(int(sys.argv[2])), indent=2) + "\n")
    print_costs(json.loads(FILE.read_text()))
