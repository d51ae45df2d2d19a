"""A real host on loopback ports, with sessions in their own processes."""

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from typing import Any, cast
from urllib.parse import urlsplit

import httpx
from websockets.sync.client import ClientConnection, connect

from avrgym.hosting.host import StudyHost
from avrgym.hosting.session_pool import HostedSession
from avrgym.study.people.invitations import create_invitations
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from avrgym.vr.protocol.messages import Hello, Message
from avrgym.vr.server.authentication import Tokens
from helpers.studies.small_studies import eligible_answers
from helpers.system.processes import AVRGYM, kill_with_parent
from helpers.vr.received_states import decode_message

PATIENCE_S = 120.0


def wait_until(condition: Callable[[], Any], what: str) -> Any:
    """Wait until a condition holds, and return its value."""
    ends_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < ends_s:
        if value := condition():
            return value
        time.sleep(0.05)
    raise TimeoutError(what)


@dataclass(frozen=True)
class Served:
    """A running host, and requests to it."""

    host: StudyHost

    def url(self, path: str, *, experimenter: bool = False) -> str:
        port = self.host.experimenter_port if experimenter else self.host.public_port
        return f"http://localhost:{port}{path}"

    def request(
        self, method: str, path: str, token: str = "", *, experimenter: bool = False, **options: Any
    ) -> httpx.Response:
        headers = options.pop("headers", {}) | ({"authorization": f"Bearer {token}"} if token else {})
        if method == "POST":
            options.setdefault("json", {})
        return httpx.request(
            method,
            self.url(path, experimenter=experimenter),
            headers=headers,
            timeout=PATIENCE_S,
            **options,
        )

    def post(self, path: str, bearer: str = "", /, **body: Any) -> httpx.Response:
        return self.request("POST", f"/api/{path}", bearer, json=body)

    def invite(self, places: int = 1) -> str:
        (invitation,) = create_invitations(self.host.store, [""], days=1, places=places)
        return invitation.token

    def enrol(self) -> tuple[str, str]:
        """Enrol a person with an invitation. Returns pseudonym and own token."""
        answer = self.post("participants", token=self.invite(), sex="woman")
        pseudonym = self.host.store.read_participants()[-1].pseudonym
        return pseudonym, answer.json()["token"]

    def stage(self, token: str) -> dict[str, Any]:
        return self.request("GET", "/api/stage", token).json()["stage"]

    def admit(self) -> tuple[str, str]:
        """Enrol a person and lead them to the waiting room. Returns pseudonym and own token."""
        pseudonym, token = self.enrol()
        shown = self.stage(token)
        agreed = {"version": shown["version"], "sha256": shown["sha256"], "agreed": True}
        for name, body in (
            ("consent", agreed),
            ("inclusion", {"answers": eligible_answers(self.host.store)}),
            ("safety", {}),
        ):
            assert self.post(name, token, **body).status_code == 204
        return pseudonym, token

    def start(self) -> tuple[HostedSession, str]:
        """Start the session of a new participant. Returns the session and the participant's own token."""
        pseudonym, token = self.admit()
        assert self.post("waiting-list", token).status_code == 204
        wait_until(lambda: self.stage(token)["type"] == "session", "the session starts")
        session = self.host.pool.find_participant_session(pseudonym)
        assert session is not None
        wait_until(lambda: session.server_address, "the session's server starts")
        return session, token

    @contextmanager
    def connect(
        self, session_id: str, token: str, channel: str = "ws", *, experimenter: bool = False, **options: Any
    ) -> Iterator[ClientConnection]:
        """A WebSocket to a session, after the hello."""
        path = self.url(f"/session/{session_id}/{channel}", experimenter=experimenter)
        with connect(path.replace("http", "ws", 1), max_size=None, proxy=None, **options) as socket:
            socket.send(
                messages.encode_message(Hello(messages.PROTOCOL_VERSION, token, "test", emulated=True))
            )
            yield socket


@dataclass(frozen=True)
class HostProcess:
    """A process of `avrgym host`, with the fields of a ``StudyHost`` that ``Served`` needs. ``store``: of the test."""

    process: subprocess.Popen[str]
    store: StudyStore
    port: int
    experimenter_port: int
    tokens: Tokens


@contextmanager
def host_process(
    store: StudyStore, *options: str, port: int = 0, experimenter_port: int = 0
) -> Iterator[tuple[HostProcess, Served]]:
    """Run `avrgym host` until the context ends; then kill it."""
    ports = ("--port", str(port), "--experimenter-port", str(experimenter_port))
    command = [AVRGYM, "host", store.folder, *ports, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, preexec_fn=kill_with_parent) as process:
        try:
            assert process.stdout is not None
            words = (word for line in process.stdout for word in line.split() if word.startswith("http"))
            participants, experimenters = (urlsplit(word).port or 0 for word in islice(words, 2))
            tokens = Tokens.load_or_create(store.folder / "private" / "tokens.json")
            host = HostProcess(process, store, participants, experimenters, tokens)
            yield host, Served(cast(StudyHost, host))
        finally:
            process.kill()


def first(socket: ClientConnection) -> Message:
    """The next message of a session."""
    message = decode_message(socket, socket.recv(PATIENCE_S))
    assert message is not None
    return message
