"""Child processes that end with the tests."""

import ctypes
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from helpers.vr.time_limits import command_with_limits

AVRGYM = Path(sys.executable).with_name("avrgym")
_PR_SET_PDEATHSIG = 1
_LIBC = ctypes.CDLL(None)


def kill_with_parent() -> None:
    """Use as ``preexec_fn``: Linux kills this process when its parent ends.

    Also restores the default signal handlers, which ``nohup`` and background shells change.
    """
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


@dataclass(frozen=True)
class RunningServer:
    """A server process and its local addresses.

    The address of ``participant`` has a token, unless a study waits for its first session.
    """

    process: subprocess.Popen[str]
    participant: str
    dashboard: str


@contextmanager
def running_server(study: Path, *options: str, limits: tuple[str, ...] = ()) -> Iterator[RunningServer]:
    """Run `avrgym serve` until the context ends."""
    command = [*command_with_limits(*limits), "serve", "--port", "0", "--study", study, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=kill_with_parent) as process:
        try:
            assert process.stdout is not None
            lines = (line.strip() for line in process.stdout)
            participant = next(line for line in lines if re.fullmatch(r"https?://[^/]*/(#token=\S+)?", line))
            dashboard = next(line for line in lines if re.search("/(dashboard|spectator)#token=", line))
            yield RunningServer(process, participant, dashboard)
        finally:
            process.kill()


def free_port() -> int:
    """Return a free port of this computer."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]
