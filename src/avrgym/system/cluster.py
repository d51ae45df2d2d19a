"""Work that is spread over the computers of a Ray cluster. Needs the extra ``cluster``.

A call is made by a worker, a process on any node. A call whose worker or node dies is made again by another, so that
calls must be such that it does no harm: functions of their arguments, or ones that go on where they were cut off.
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

from avrgym.system import jobs

Result = TypeVar("Result")

LOOK_EVERY_S = 0.5
RESPONSE_TIMEOUT_S = 5.0
"""How long a cluster may take to take a connection."""
BEGIN_WITHIN_S = 300.0
"""How long no worker at all may have begun: some clusters start computers as they are needed."""
MOST_DEATHS = 8
"""After how many deaths of its workers, one after the other, a call is taken to be their cause."""
PROCESS_BYTES = 400 << 20
"""What a worker holds before it has any worlds."""
VARIABLES = "AVRGYM_"
"""Environment variables with this beginning are those of the workers too."""
COMPARED = ("avrgym", "mujoco", "numpy")
"""Packages of which every computer needs the same version, since results are to be the same to the bit."""


class _Worker:
    """A process on a node: it makes one call after the other."""

    def begin(self, variables: Mapping[str, str]) -> dict[str, str]:
        os.environ.update(variables)
        return _versions()

    def call(self, function: Callable[..., Any], *arguments: Any) -> tuple[Any, int]:
        """What the function gives, and how much it reported."""
        with jobs.counting() as reported:
            result = function(*arguments)
        return result, reported()


@dataclass
class _Running:
    """What a worker is doing: the call of this number, or nothing yet while it begins."""

    worker: Any
    number: int | None


class Cluster:
    """A connection to a cluster, and the workers that were begun there."""

    def __init__(self, address: str, most_jobs: int | None) -> None:
        self.address = address
        self.asked_for = most_jobs
        """How many workers were asked for, if any."""
        self._idle: list[Any] = []
        self._beginning: dict[Any, _Running] = {}
        self._bytes = PROCESS_BYTES
        self._variables = {name: value for name, value in os.environ.items() if name.startswith(VARIABLES)}

    @property
    def count(self) -> int:
        """How many calls run at the same time: as many as the cluster has cores, or as were asked for."""
        return self.asked_for or max(1, int(ray.cluster_resources().get("CPU", 1)))

    def several_computers(self) -> bool:
        """Whether any of the cluster's nodes is another computer than this one."""
        names = {node["NodeManagerHostname"] for node in ray.nodes() if node["Alive"]}
        return names != {socket.gethostname()}

    def need(self, memory_bytes: int) -> None:
        """Have every worker that begins from now on find so much memory beside ``PROCESS_BYTES``.

        Raises:
            RuntimeError: where no node has as much.
        """
        wanted = PROCESS_BYTES + memory_bytes
        most = max((node["Resources"].get("memory", 0) for node in ray.nodes() if node["Alive"]), default=0)
        if wanted > most:
            raise RuntimeError(
                f"a worker would need {wanted / 2**30:.1f} GiB of memory, and the largest node of the cluster has "
                f"{most / 2**30:.1f}: let more workers share the worlds, or take fewer worlds"
            )
        self._bytes = wanted

    def run_all(
        self,
        function: Callable[..., Result],
        arguments: Sequence[tuple[Any, ...]],
        tell: Callable[[int], None] = lambda done: None,
    ) -> list[Result]:
        """What a function gives of each arguments, in their order; the first error ends all.

        An object that stands in several of the arguments travels to each node once.

        Args:
            function: of a module, so that the workers find it.
            arguments: one tuple for each call.
            tell: told again and again how much the calls that have ended reported.

        Raises:
            RuntimeError: where no worker begins, or a call's workers die again and again.
        """
        calls = _Calls(function, _shared_once(arguments))
        running: dict[Any, _Running] = {}
        try:
            self._work(calls, running, tell)
        except BaseException:
            for each in running.values():
                ray.kill(each.worker)
            raise
        return [calls.results[number] for number in range(len(arguments))]

    def _work(self, calls: "_Calls", running: dict[Any, _Running], tell: Callable[[int], None]) -> None:
        last_sign = time.monotonic()
        while calls.waiting or running:
            self._begin_workers(len(calls.waiting) + len(running), len(running))
            while self._idle and calls.waiting:
                worker, number = self._idle.pop(), calls.waiting.popleft()
                running[worker.call.remote(calls.function, *calls.arguments[number])] = _Running(
                    worker, number
                )
            watched = [*running, *self._beginning]
            for reference in ray.wait(watched, timeout=LOOK_EVERY_S)[0]:
                last_sign = time.monotonic()
                if reference in running:
                    self._end(reference, running.pop(reference), calls)
                else:
                    self._begun(reference, self._beginning.pop(reference))
            tell(calls.reported)
            if not running and time.monotonic() - last_sign > BEGIN_WITHIN_S:
                raise RuntimeError(
                    f"no worker of the cluster {self.address} has begun for {BEGIN_WITHIN_S:.0f} s"
                )

    def _begin_workers(self, wanted: int, busy: int) -> None:
        """Begin as many workers as there is work for."""
        there = busy + len(self._idle) + len(self._beginning)
        for _ in range(min(wanted, self.count) - there):
            worker = ray.remote(_Worker).options(num_cpus=1, memory=self._bytes, max_restarts=0).remote()
            self._beginning[worker.begin.remote(self._variables)] = _Running(worker, None)

    def _begun(self, reference: Any, begun: _Running) -> None:
        try:
            found = ray.get(reference)
        except (RayActorError, WorkerCrashedError):
            return  # its node died; another worker takes its place
        _check_versions(found)
        self._idle.append(begun.worker)

    def _ask_again(self) -> None:
        """See which of the workers that wait for work are still there: they may have died with their node."""
        for worker in self._idle:
            self._beginning[worker.begin.remote(self._variables)] = _Running(worker, None)
        self._idle.clear()

    def _end(self, reference: Any, ended: _Running, calls: "_Calls") -> None:
        assert ended.number is not None
        try:
            result, reported = ray.get(reference)
        except RayTaskError as error:
            raise error.cause or error from None
        except RayError as error:  # worker or node died, or what it gave was lost with its node
            calls.died(ended.number, error)
            ray.kill(ended.worker)
            self._ask_again()
            return
        calls.take(ended.number, result, reported)
        self._idle.append(ended.worker)


class _Calls:
    """Calls of a function, and what came of them."""

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
        """Have a call made again."""
        self._deaths[number] += 1
        if self._deaths[number] == MOST_DEATHS:
            reason = str(error).strip().splitlines()[0]
            raise RuntimeError(f"{MOST_DEATHS} workers died one after the other over the same call: {reason}")
        self.waiting.appendleft(number)


def _shared_once(arguments: Sequence[tuple[Any, ...]]) -> list[tuple[Any, ...]]:
    """The arguments, with what stands in several of them put where every node fetches it once."""
    times = Counter(id(each) for some in arguments for each in some)
    put: dict[int, Any] = {}

    def stand_in(each: Any) -> Any:
        if times[id(each)] == 1 or isinstance(each, bool | int | float | str | None):
            return each
        if id(each) not in put:
            put[id(each)] = ray.put(each)
        return put[id(each)]

    return [tuple(stand_in(each) for each in some) for some in arguments]


def _versions() -> dict[str, str]:
    return {"Python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in COMPARED
    }


def _check_versions(found: Mapping[str, str]) -> None:
    here = _versions()
    for name, version in found.items():
        if version != here[name]:
            raise RuntimeError(
                f"a node of the cluster has {name} {version}, and this computer {here[name]}: "
                "results are the same to the bit only with the same versions"
            )


@contextmanager
def connected(address: str, most_jobs: int | None = None) -> Generator[Cluster]:
    """A connection to a cluster as long as the context lasts.

    Args:
        address: ``local`` for a cluster on this computer that ends with the context; ``auto`` for the one that this
            computer belongs to; HOST:PORT of a head node; or ``ray://HOST:PORT``.
        most_jobs: how many workers there are at most; without it one for each core.

    Raises:
        ValueError: for an address that is none.
        RuntimeError: where no cluster answers.
    """
    if address not in ("local", "auto"):
        _check_answers(address)
    quiet: dict[str, Any] = {"logging_level": "ERROR", "log_to_driver": False, "include_dashboard": False}
    if address == "local":
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        quiet["num_cpus"] = jobs.cores()
    elif address.startswith("ray://"):
        quiet = {"log_to_driver": False}
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        ray.init(address=address, **quiet)
    except Exception as error:  # Ray raises many kinds, also the bare one
        raise RuntimeError(f"no Ray cluster at {address}: {_first_line(error)}") from error
    try:
        yield Cluster(address, most_jobs)
    finally:
        ray.shutdown()


def _check_answers(address: str) -> None:
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"{address!r} is no cluster; allowed: local, auto, HOST:PORT or ray://HOST:PORT")
    try:
        socket.create_connection((host.strip("[]"), int(port)), RESPONSE_TIMEOUT_S).close()
    except OSError as error:
        raise RuntimeError(
            f"no Ray cluster answers at {address} ({error.strerror or error}); `ray start --head` begins one, and "
            "--cluster local needs none"
        ) from error


def _first_line(error: Exception) -> str:
    lines: Iterable[str] = str(error).strip().splitlines()
    return next(iter(lines), type(error).__name__)
