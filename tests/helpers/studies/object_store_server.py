"""A server with the S3 protocol on this computer: moto in its own process."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.client import HTTPConnection

import pytest

from helpers.system.processes import kill_with_parent

ADDRESS = "s3://studies/my-study"
START_TIMEOUT_S = 60.0


def set_object_store(patch: pytest.MonkeyPatch, port: int) -> None:
    """Set the variables with the address and the credentials of the object store at a port."""
    for name in [each for each in os.environ if each.startswith("AWS_")]:
        patch.delenv(name)
    patch.setenv("AVRGYM_STUDY_RECORDINGS", ADDRESS)
    patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
    patch.setenv("AWS_ACCESS_KEY_ID", "key")
    patch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    patch.setenv("AWS_DEFAULT_REGION", "us-east-1")


@contextmanager
def object_store_server(port: int) -> Iterator[subprocess.Popen[bytes]]:
    """Run the server at a port. It is empty at the start. Yields its process."""
    command = [sys.executable, "-m", "moto.server", "--host", "127.0.0.1", "--port", str(port)]
    quiet = subprocess.DEVNULL
    with subprocess.Popen(command, preexec_fn=kill_with_parent, stdout=quiet, stderr=quiet) as process:
        try:
            _await(port)
            yield process
        finally:
            process.kill()


def stop_for(process: subprocess.Popen[bytes], seconds: float) -> threading.Timer:
    """Stop the server's process for a time. It then accepts connections, but does not answer. Returns the timer."""
    process.send_signal(signal.SIGSTOP)
    timer = threading.Timer(seconds, process.send_signal, (signal.SIGCONT,))
    timer.start()
    return timer


def _await(port: int) -> None:
    deadline_s = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline_s:
        connection = HTTPConnection("127.0.0.1", port, timeout=5.0)
        with suppress(OSError):
            connection.request("GET", "/")
            connection.getresponse().read()
            return
        connection.close()
        time.sleep(0.1)
    raise TimeoutError("the object store did not start")
