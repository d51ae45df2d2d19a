"""Check real-time performance, system limits and disk space."""

import getpass
import os
import shutil
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

from avrgym.doctor.finding import Finding, make_error_finding, make_ok_finding, make_warning_finding
from avrgym.system.files import write_atomically
from avrgym.system.locks import lock_folder
from avrgym.vr.protocol.messages import TICK_S
from avrgym.vr.server import cpu_idle
from avrgym.vr.server.connection_limits import (
    MAX_UNAUTHENTICATED_CONNECTIONS,
    UNAUTHENTICATED_FILE_HANDLE_DIVISOR,
    read_max_open_files,
)
from avrgym.vr.server.real_time_loop import REAL_TIME_PRIORITY, use_real_time_priority

SLEEP_SAMPLE_COUNT = 20
MAX_OVERSLEEP_FRACTION = 0.2
"""Maximum oversleep as a share of a tick. Oversleep: actual minus requested duration of a sleep."""
RECORDING_BYTES_PER_TRIAL = 1_000_000
"""Size in bytes of the recording of a trial of 20 s. Recordings in ``tests/data/recordings-of-0.1.0`` have 0.8 to 1.0
MB."""
MIN_TRIALS_WITHOUT_WARNING, MIN_TRIALS_WITHOUT_ERROR = 1000, 100


def check_processor_count() -> Finding:
    """Check whether this computer has at least two processors, as live sessions need."""
    count = _processor_count()
    if count > 1:
        return make_ok_finding(f"{count}")
    return make_warning_finding("one, shared by simulation and server", "provide two or more processors")


def _processor_count() -> int:
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def check_real_time_priority() -> Finding:
    """Check whether the operating system allows real-time priority for the simulation's thread."""
    if sys.platform != "linux" or _processor_count() == 1:
        return make_ok_finding("not available on this system")
    with ThreadPoolExecutor(1) as thread:
        if thread.submit(use_real_time_priority).result():
            return make_ok_finding("the simulation's thread may have real-time priority")
    return make_warning_finding(
        "the simulation's thread may not have real-time priority, so a busy computer delays it",
        f"put `{_user()} - rtprio {REAL_TIME_PRIORITY}` into /etc/security/limits.conf and log in again",
    )


def _user() -> str:
    """Returns the name of the current user, or the user id if there is no name (in some containers)."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):
        return str(os.getuid())


def measure_oversleep_s() -> float:
    """Returns the median oversleep in seconds: actual minus requested duration of a sleep of one tick."""
    excesses_s: list[float] = []
    for _ in range(SLEEP_SAMPLE_COUNT):
        began = time.monotonic()
        time.sleep(TICK_S)
        excesses_s.append(time.monotonic() - began - TICK_S)
    return median(excesses_s)


def check_sleep_precision(excess_s: float) -> Finding:
    """Check whether sleeps are precise enough for ticks of 10 ms.

    ``excess_s``: result of ``measure_oversleep_s``.
    """
    text = f"a sleep of {1000 * TICK_S:.0f} ms is {1000 * excess_s:.1f} ms too long"
    if excess_s <= MAX_OVERSLEEP_FRACTION * TICK_S:
        return make_ok_finding(text)
    return make_warning_finding(text, "close other programs, and set the computer to its highest performance")


def check_cpu_idle_states(
    driver: Path = cpu_idle.CPU_IDLE_DRIVER_FILE, latency: Path = cpu_idle.CPU_LATENCY_FILE
) -> Finding:
    """Check whether idle processors wake up quickly.

    In a virtual machine, write access to the file ``latency`` is required.
    """
    if not driver.exists() or driver.read_text().strip() != cpu_idle.GUEST_IDLE_DRIVER:
        return make_ok_finding("idle processors wake immediately")
    if os.access(latency, os.W_OK, effective_ids=True):
        return make_ok_finding("the processors of this virtual machine can be kept awake")
    return make_warning_finding(
        "the processors of this virtual machine cannot be kept awake, so ticks may be late",
        f"sudo chmod o+w {latency}, which lasts until the next start",
    )


def check_open_file_limit(number: int | None = None) -> Finding:
    """Check whether the maximum number of open files is enough for a server.

    ``number``: the maximum number; default: the limit of this process.
    """
    allowed = read_max_open_files() if number is None else number
    needed = UNAUTHENTICATED_FILE_HANDLE_DIVISOR * MAX_UNAUTHENTICATED_CONNECTIONS
    if allowed >= needed:
        return make_ok_finding(f"{allowed}")
    return make_warning_finding(f"{allowed}, which limits the number of browsers", f"ulimit -n {needed}")


def check_folder_writable(folder: Path) -> Finding:
    """Check whether files can be written and locked in a folder, or whether the folder can be created."""
    place = _existing_parent(folder)
    try:
        with TemporaryDirectory(prefix=".avrgym-doctor-", dir=place) as trial:
            write_atomically(Path(trial) / "file", b"written")
            with lock_folder(Path(trial)):
                return make_ok_finding(f"{folder}" if place == folder else f"{folder} can be created")
    except OSError as failure:
        return make_error_finding(
            f"{place} is not writable: {failure.strerror}",
            f"choose another folder, or sudo chown {_user()} '{place}'",
        )
    except ValueError as failure:
        return make_error_finding(str(failure), "a network file system may lack locks: use a local folder")


def check_free_space(folder: Path) -> Finding:
    """Check whether the folder's disk has enough space for the recordings of a study."""
    return check_free_bytes(shutil.disk_usage(_existing_parent(folder)).free)


def check_free_bytes(free_bytes: int) -> Finding:
    """Check whether this number of free bytes is enough for the recordings of a study."""
    trials = free_bytes // RECORDING_BYTES_PER_TRIAL
    text = f"{free_bytes / 1e9:.1f} GB free, enough for about {trials} trials"
    fix = "free disk space, or use another disk"
    if trials < MIN_TRIALS_WITHOUT_ERROR:
        return make_error_finding(text, fix)
    return make_warning_finding(text, fix) if trials < MIN_TRIALS_WITHOUT_WARNING else make_ok_finding(text)


def _existing_parent(folder: Path) -> Path:
    """Returns the folder if it exists, else its nearest existing parent."""
    return next(each for each in (folder, *folder.absolute().parents) if os.path.isdir(each))
