"""Run function calls on the computers of a Ray cluster. Requires the extra ``cluster``.

A worker is a process on any node. It runs one call after another. If a worker or node dies, another worker repeats the
call. A repeated call must return the same result. A function must therefore depend only on its arguments, or continue
its own unfinished work.
"""

import importlib.metadata
import os
import platform
import socket
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

import ray
from ray.exceptions import RayActorError, RayError, RayTaskError, WorkerCrashedError

from avrgym.system import parallel_calls

Result = TypeVar("Result")

POLL_INTERVAL_S = 0.5
CONNECTION_TIMEOUT_S = 5.0
WORKER_START_TIMEOUT_S = 300.0
"""Maximum time until the first worker starts. Some clusters start computers on demand."""
MAX_WORKER_DEATHS = 8
"""Number of unexpected ends of worker processes in one call after which the call fails."""
BASE_WORKER_BYTES = 400 << 20
"""Memory in bytes of a worker process without simulated worlds."""
ENV_VAR_PREFIX = "AVRGYM_"
"""Environment variables with this prefix are copied to the workers."""
VERSION_CHECKED_PACKAGES = ("avrgym", "mujoco", "numpy")
"""All computers must have the same versions of these packages, because results must be bit-identical."""


class _Worker:
    """A process on a node of the cluster. It runs one call after another."""

    def start(self, variables: Mapping[str, str]) -> dict[str, str]:
        os.environ.update(variables)
        return find_installed_versions()

    def call(self, function: Callable[..., Any], *arguments: Any) -> tuple[Any, int]:
        """Call a function. Returns its result, and the sum of its progress reports."""
        with parallel_calls.count_progress() as reported:
            result = function(*arguments)
        return result, reported()


@dataclass
class _Running:
    """A worker, and the number of its current call. The number is ``None`` while the worker starts."""

    worker: Any
    number: int | None


class Cluster:
    """Runs function calls on the workers of a connected Ray cluster."""

    def __init__(self, address: str, max_jobs: int | None) -> None:
        self.address = address
        self.max_jobs = max_jobs
        """Requested number of workers; ``None`` for one per core."""
        self._idle: list[Any] = []
        self._starting: dict[Any, _Running] = {}
        self._bytes = BASE_WORKER_BYTES
        self._variables = {
            name: value for name, value in os.environ.items() if name.startswith(ENV_VAR_PREFIX)
        }

    @property
    def max_parallel_calls(self) -> int:
        """Returns the maximum number of parallel calls: the requested number, or the number of cores in the cluster."""
        return self.max_jobs or max(1, int(ray.cluster_resources().get("CPU", 1)))

    def has_remote_nodes(self) -> bool:
        """Returns whether the cluster has nodes on other computers."""
        names = {node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}
        return names != {socket.gethostname()}

    def reserve_memory(self, memory_bytes: int) -> None:
        """Reserve memory for each new worker, in addition to ``BASE_WORKER_BYTES``.

        Raises:
            RuntimeError: if no node has enough memory.
        """
        wanted = BASE_WORKER_BYTES + memory_bytes
        largest = max(
            (node["Resources"].get("memory", 0) for node in ray.nodes() if node["Alive"]), default=0
        )
        if wanted > largest:
            raise RuntimeError(
                f"each worker needs {wanted / 2**30:.1f} GiB of memory, but the largest node of the cluster has "
                f"{largest / 2**30:.1f} GiB; use more workers (--jobs) or fewer worlds"
            )
        self._bytes = wanted

    def starmap(
        self,
        function: Callable[..., Result],
        arguments: Sequence[tuple[Any, ...]],
        progress: Callable[[int], None] = lambda done: None,
    ) -> list[Result]:
        """Call a function for each tuple of arguments. Returns the results in the order of the tuples.

        If a call raises an exception, all other calls are cancelled. An object that several tuples contain is sent to
        each node only once.

        Args:
            function: a function that workers can import from its module.
            arguments: one tuple for each call.
            progress: called repeatedly with the sum of the progress reports of all finished calls.

        Raises:
            RuntimeError: if no worker starts, or if the workers of a call die repeatedly.
        """
        calls = _Calls(function, _shared_once(arguments))
        running: dict[Any, _Running] = {}
        try:
            self._work(calls, running, progress)
        except BaseException:
            for each in running.values():
                ray.kill(each.worker)
            raise
        return [calls.results[number] for number in range(len(arguments))]

    def _work(self, calls: "_Calls", running: dict[Any, _Running], progress: Callable[[int], None]) -> None:
        last_event = time.monotonic()
        while calls.waiting or running:
            self._start_workers(len(calls.waiting) + len(running), len(running))
            while self._idle and calls.waiting:
                worker, number = self._idle.pop(), calls.waiting.popleft()
                running[worker.call.remote(calls.function, *calls.arguments[number])] = _Running(
                    worker, number
                )
            watched = [*running, *self._starting]
            for reference in ray.wait(watched, timeout=POLL_INTERVAL_S)[0]:
                last_event = time.monotonic()
                if reference in running:
                    self._end(reference, running.pop(reference), calls)
                else:
                    self._started(reference, self._starting.pop(reference))
            progress(calls.reported)
            if not running and time.monotonic() - last_event > WORKER_START_TIMEOUT_S:
                raise RuntimeError(
                    f"no worker of the cluster {self.address} has started within {WORKER_START_TIMEOUT_S:.0f} s; "
                    "check the free cores and memory with `ray status`"
                )

    def _start_workers(self, wanted: int, busy: int) -> None:
        """Start workers until there are ``wanted`` workers, but at most ``max_parallel_calls``. ``busy`` workers run a
        call.
        """
        present = busy + len(self._idle) + len(self._starting)
        for _ in range(min(wanted, self.max_parallel_calls) - present):
            worker = ray.remote(_Worker).options(num_cpus=1, memory=self._bytes, max_restarts=0).remote()
            self._starting[worker.start.remote(self._variables)] = _Running(worker, None)

    def _started(self, reference: Any, started: _Running) -> None:
        try:
            found = ray.get(reference)
        except (RayActorError, WorkerCrashedError):
            return  # the worker ended before its first call; another worker replaces it
        check_versions(found)
        self._idle.append(started.worker)

    def _check_idle(self) -> None:
        """Call ``start`` of all idle workers again, to find and remove workers on a failed node."""
        for worker in self._idle:
            self._starting[worker.start.remote(self._variables)] = _Running(worker, None)
        self._idle.clear()

    def _end(self, reference: Any, ended: _Running, calls: "_Calls") -> None:
        assert ended.number is not None
        try:
            result, reported = ray.get(reference)
        except RayTaskError as error:
            raise error.cause or error from None
        except RayError as error:  # worker or node died, or the result was lost with its node
            calls.died(ended.number, error)
            ray.kill(ended.worker)
            self._check_idle()
            return
        calls.take(ended.number, result, reported)
        self._idle.append(ended.worker)


class _Calls:
    """The calls of one function in ``Cluster.starmap``, and their results."""

    def __init__(self, function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> None:
        self.function, self.arguments = function, arguments
        self.waiting = deque(range(len(arguments)))
        self.results: dict[int, Any] = {}
        self.reported = 0
        self._deaths: Counter[int] = Counter()

    def take(self, number: int, result: Any, reported: int) -> None:
        self.results[number] = result
        self.reported += reported

    def died(self, number: int, error: Exception) -> None:
        """Queue a call again after its worker ended unexpectedly. Raises ``RuntimeError`` after ``MAX_WORKER_DEATHS``
        such ends.
        """
        self._deaths[number] += 1
        if self._deaths[number] == MAX_WORKER_DEATHS:
            reason = str(error).strip().splitlines()[0]
            raise RuntimeError(
                f"{MAX_WORKER_DEATHS} worker processes ended unexpectedly in the same call: {reason}; "
                "check the memory of the nodes and the logs of Ray"
            )
        self.waiting.appendleft(number)


def _shared_once(arguments: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """Returns the arguments. Objects that several tuples contain are replaced by references of Ray."""
    counts = Counter(id(each) for call in arguments for each in call)
    put: dict[int, Any] = {}

    def ray_reference(each: Any) -> Any:
        if counts[id(each)] == 1 or isinstance(each, bool | int | float | str | None):
            return each
        if id(each) not in put:
            put[id(each)] = ray.put(each)
        return put[id(each)]

    return [tuple(ray_reference(each) for each in call) for call in arguments]


def find_installed_versions() -> dict[str, str]:
    """Returns the versions of Python and of the packages in ``VERSION_CHECKED_PACKAGES``."""
    return {"Python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in VERSION_CHECKED_PACKAGES
    }


def check_versions(found: Mapping[str, str]) -> None:
    """Raises ``RuntimeError`` if a node has other versions than this computer. ``found``: versions on the node."""
    local = find_installed_versions()
    for name, version in found.items():
        if version != local[name]:
            raise RuntimeError(
                f"a node of the cluster has {name} {version}, but this computer has {local[name]}; "
                "install the same version on all computers, because results must be bit-identical"
            )


@contextmanager
def connect_to_cluster(address: str, max_jobs: int | None = None) -> Generator[Cluster]:
    """Context manager: yields a connection to a Ray cluster.

    Args:
        address: ``local`` starts a cluster on this computer, which ends with the context. ``auto`` is the running
            cluster of this computer. Otherwise HOST:PORT of a head node, or ``ray://HOST:PORT``.
        max_jobs: maximum number of workers; default: one per core.

    Raises:
        ValueError: for an invalid address.
        RuntimeError: if no cluster answers.
    """
    if address not in ("local", "auto"):
        _check_answers(address)
    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False, "include_dashboard": False}
    if address == "local":
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet["num_cpus"] = parallel_calls.count_available_cores()
    elif address.startswith("ray://"):
        quiet = {"log_to_driver": False}
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        ray.init(address=address, **quiet)
    except Exception as error:  # Ray raises many kinds of errors
        raise RuntimeError(
            f"cannot connect to a Ray cluster at {address}: {_first_line(error)}; `ray start --head` starts a cluster"
        ) from error
    try:
        yield Cluster(address, max_jobs)
    finally:
        ray.shutdown()


def _check_answers(address: str) -> None:
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(
            f"invalid cluster address {address!r}; allowed: local, auto, HOST:PORT or ray://HOST:PORT"
        )
    try:
        socket.create_connection((host.strip("[]"), int(port)), CONNECTION_TIMEOUT_S).close()
    except OSError as error:
        raise RuntimeError(
            f"no Ray cluster answers at {address} ({error.strerror or error}); start one with `ray start --head`, "
            "or use --cluster local"
        ) from error


def _first_line(error: Exception) -> str:
    lines: Iterable[str] = str(error).strip().splitlines()
    return next(iter(lines), type(error).__name__)
