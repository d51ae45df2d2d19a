"""Sessions on the nodes of a Ray cluster. Requires the extra ``cluster``.

The process of an actor runs a session as ``session_process`` does, in a temporary copy of the study's files. Its rows
are in PostgreSQL. Its recordings are in the object store before the end of an attempt is stored. Therefore the death of
a process or a node only interrupts the running attempt. The next process repeats it on any node.

The host connects to the nodes, for reports, commands and the participants' WebSockets. These connections are not
encrypted. Like those of Ray, they belong into a private network.
"""

import os
import secrets
import shutil
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Client, Connection, Listener, wait
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import Any
from urllib.parse import urlsplit

import ray
from ray.exceptions import RayError

from avrgym.hosting.capacity import SessionCapacity
from avrgym.hosting.computers import SessionProcess
from avrgym.hosting.session_process import SessionRequest, run_session
from avrgym.study.design.design import DESIGN_FILE as DESIGN
from avrgym.study.plan.study_files import list_study_files
from avrgym.study.storage.database import DATABASE_URL_VARIABLE, find_database_url
from avrgym.study.storage.identity_file import IDENTITY_FOLDER as PRIVATE
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.system.cluster import BASE_WORKER_BYTES, Cluster, check_versions, find_installed_versions
from avrgym.system.processes import is_process_running
from avrgym.system.transferred_files import TransferredFile
from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS
from avrgym.vr.server.sound_files import SOUNDS_FOLDER

SESSION_START_TIMEOUT_S = 110.0
SESSION_END_TIMEOUT_S = 30.0
POLL_INTERVAL_S = 0.5
NODE_LIST_INTERVAL_S = 2.0
SENT_ENVIRONMENT_VARIABLE_PREFIXES = ("AVRGYM_", "AWS_")
"""Prefixes of the environment variables that sessions get: addresses and credentials of database and object store."""
SESSION_FOLDER_PREFIX = "avrgym-session-"


class RayNodes:
    """The nodes of a cluster that can run sessions of a study, as a function without arguments."""

    def __init__(self, store: StudyStore, cluster: Cluster) -> None:
        """Check that the nodes can reach the study's database and object store.

        Raises:
            StudyError: if the study has no PostgreSQL database or no object store.
        """
        url = find_database_url(store.design.database.url)
        if not url:
            raise StudyError(
                "--cluster needs a PostgreSQL database: set `url` under [database] in study.toml, or "
                f"{DATABASE_URL_VARIABLE}"
            )
        if store.object_store is None:
            raise StudyError(
                "--cluster needs an object store for recordings: set `url` under [recordings] in study.toml"
            )
        if cluster.has_remote_nodes() and urlsplit(url).hostname in (*LOOPBACK_HOSTS, "", None):
            raise StudyError(
                "the database URL contains a loopback address, which other nodes of the cluster cannot reach; allowed: "
                "an address of this computer in their network, such as postgresql://user@10.0.0.1/name"
            )
        self._store, self._nodes, self._asked_s = store, dict[str, RayNode](), -NODE_LIST_INTERVAL_S

    def __call__(self) -> list["RayNode"]:
        """Returns the living nodes with at least one core. Nodes may come and go."""
        now_s = time.monotonic()
        if now_s - self._asked_s >= NODE_LIST_INTERVAL_S:
            self._asked_s = now_s
            with suppress(RayError):
                found = {
                    each["NodeID"]: int(each["Resources"].get("CPU", 0))
                    for each in ray.nodes()
                    if each["Alive"]
                }
                self._nodes = {
                    name: self._nodes.get(name) or RayNode(self._store, name, cores)
                    for name, cores in found.items()
                    if cores
                }
        return list(self._nodes.values())


class RayNode:
    """A node of the cluster, as a ``Computer``. ``name``: Ray's id of the node."""

    def __init__(self, store: StudyStore, name: str, cores: int) -> None:
        self.capacity, self.node_id, self._store = SessionCapacity(cores), name, store

    def start_session(self, request: SessionRequest) -> tuple[SessionProcess, Connection]:
        """Start a session in an actor on this node; see ``Computer``."""
        strategy = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(self.node_id, soft=False)
        actor = (
            ray.remote(_SessionActor)
            .options(num_cpus=0, memory=BASE_WORKER_BYTES, max_restarts=0, scheduling_strategy=strategy)
            .remote()
        )
        pipe, theirs = Pipe()
        session = _NodeSession(self._store, actor, request, theirs)
        session.start()
        return session, pipe


class _NodeSession(threading.Thread):
    """Thread of the host: passes messages between the host's pipe and a session on a node until the session ends."""

    def __init__(self, store: StudyStore, actor: Any, request: SessionRequest, pipe: Connection) -> None:
        super().__init__(name=f"session of {request.pseudonym}", daemon=True)
        self.pid: int | None = None
        self._store, self._actor, self._request, self._pipe = store, actor, request, pipe

    def kill(self) -> None:
        """Kill the actor that runs the session on its node."""
        ray.kill(self._actor)

    def run(self) -> None:
        """Pass messages until one side ends."""
        try:
            with suppress(RayError, EOFError, OSError):  # the pool replaces the session
                self._pass_messages()
        finally:
            self._pipe.close()
            self.kill()
            with suppress(StudyError, OSError):  # the participation list lacks what happened on the node
                self._store.database.reconcile_participation()

    def _pass_messages(self) -> None:
        key = secrets.token_bytes(32)
        listening = self._actor.listen.remote(
            self._request, pack_session_files(self._store), _variables(self._store), key
        )
        address, self.pid, versions = ray.get(listening, timeout=SESSION_START_TIMEOUT_S)
        try:
            check_versions(versions)
        except RuntimeError as error:
            self._pipe.send(str(error))
            return
        ended = self._actor.run.remote()
        try:
            with Client(address, authkey=key) as remote:
                while not ray.wait([ended], timeout=0)[0]:
                    for each in wait([remote, self._pipe], POLL_INTERVAL_S):
                        other = self._pipe if each is remote else remote
                        assert isinstance(each, Connection)
                        other.send(each.recv())
        finally:
            ray.wait([ended], timeout=SESSION_END_TIMEOUT_S)  # the session stores its end


class _SessionActor:
    """A process on a node that runs one session."""

    def listen(
        self, request: SessionRequest, files: TransferredFile, variables: Mapping[str, str], key: bytes
    ) -> tuple[tuple[str, int], int, dict[str, str]]:
        """Wait for the host's connection. Returns address and port, the id of the process, and its versions.

        Args:
            request: the session.
            files: the files of the study.
            variables: environment variables for database and object store.
            key: secret that authenticates the host.
        """
        os.environ.update(variables)
        _remove_leftovers()
        host: str = ray.util.get_node_ip_address()
        self._request, self._files = replace(request, listen_address=host, is_temporary=True), files
        self._listener = Listener((host, 0), authkey=key)
        return (host, int(self._listener.address[1])), os.getpid(), find_installed_versions()

    def run(self) -> None:
        """Run the session in a temporary folder, until it or the host has ended."""
        with (
            TemporaryDirectory(prefix=f"{SESSION_FOLDER_PREFIX}{os.getpid()}-") as temporary,
            self._listener.accept() as pipe,
        ):
            os.environ["XDG_DATA_HOME"] = temporary  # for the signing key of the temporary participation list
            folder = Path(temporary) / self._request.study_folder.name
            self._files.write(folder)
            run_session(replace(self._request, study_folder=folder), pipe)


def pack_session_files(store: StudyStore) -> TransferredFile:
    """Returns the files of the study that a session needs. Recordings and names of participants are not among them."""
    sounds = (path for path in (store.folder / SOUNDS_FOLDER).rglob("*") if path.is_file())
    needed = [
        store.folder / name for name in (DESIGN, *list_study_files(store), Path(PRIVATE) / "tokens.json")
    ]
    return TransferredFile.read_folder(str(store.folder), [*needed, *sounds])


def _variables(store: StudyStore) -> dict[str, str]:
    given = {
        name: value
        for name, value in os.environ.items()
        if name.startswith(SENT_ENVIRONMENT_VARIABLE_PREFIXES)
    }
    return given | {DATABASE_URL_VARIABLE: find_database_url(store.design.database.url)}


def _remove_leftovers() -> None:
    """Remove the temporary folders of killed sessions."""
    for path in Path(gettempdir()).glob(f"{SESSION_FOLDER_PREFIX}*"):
        process = path.name.removeprefix(SESSION_FOLDER_PREFIX).partition("-")[0]
        if process.isdecimal() and not is_process_running(int(process)):
            shutil.rmtree(path, ignore_errors=True)
