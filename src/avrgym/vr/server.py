"""The VR server: serves the client, the scenes and the WebSocket of one participant's session."""

import asyncio
import contextlib
import multiprocessing
import os
import secrets
import socket
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Generic
from urllib.parse import urlsplit

import msgspec
import uvicorn
from fastapi import FastAPI, HTTPException, Request, Response, WebSocket, WebSocketDisconnect
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

from avrgym.models.human import Person
from avrgym.models.robots import find_robot
from avrgym.models.scene import build_spec
from avrgym.tasks import TASKS, find_environment
from avrgym.vr import messages
from avrgym.vr.loop import RealTimeLoop, S
from avrgym.vr.messages import ClientMessage, Hello, Message, State, Welcome
from avrgym.vr.scene_export import export_glb
from avrgym.vr.session import Disconnected
from avrgym.vr.world import TICK_S

STATIC = Path(__file__).parent / "static"
LOOPBACK = ("127.0.0.1", "localhost")
HELLO_TIMEOUT_S = 5.0
MAX_MESSAGE_BYTES = 1 << 16
OUTBOX_MESSAGES = 1000
"""What a connection may still have to send; of more, which only floods lead to, the oldest are dropped."""
PING_INTERVAL_S, PING_TIMEOUT_S = 1.0, 4.0
"""How a connection is found dead that did not say goodbye: a headset that fell asleep or left the network."""
FAREWELL_S = 5
SCENES_KEPT = 4
CLIENT_TYPES = "hello, tracking, entered, left, ready, scene_loaded, stop, origin_reset, answer"


class ServerError(RuntimeError):
    """The server cannot start; the message says why and what to do."""


def render_scene(environment_id: str, person: Person) -> bytes:
    """The GLB of an environment with a person in it."""
    task, robot = find_environment(environment_id)
    stage = TASKS[task].stage(find_robot(robot))
    return export_glb(build_spec(stage, person, moving=True, appearance=True).compile())


class SceneRenderer:
    """Renders scenes in a process of its own, away from the real-time thread: each once, whoever asks."""

    def __init__(self) -> None:
        self._pool = _rendering_process()
        self._scenes: dict[int, asyncio.Task[bytes]] = {}

    async def glb(self, number: int, environment_id: str, person: Person) -> bytes:
        """The scene of a number; a failure is raised to all who wait, and the next request tries again."""
        if number not in self._scenes:
            self._scenes[number] = asyncio.create_task(self._render(environment_id, person))
            while len(self._scenes) > SCENES_KEPT:
                del self._scenes[next(iter(self._scenes))]
        try:
            return await asyncio.shield(self._scenes[number])
        except Exception:
            self._scenes.pop(number, None)
            raise

    async def _render(self, environment_id: str, person: Person) -> bytes:
        events = asyncio.get_running_loop()
        try:
            return await events.run_in_executor(self._pool, render_scene, environment_id, person)
        except BrokenProcessPool:
            self._pool = _rendering_process()
            raise

    def close(self) -> None:
        """End the process."""
        self._pool.shutdown(cancel_futures=True)


def _rendering_process() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(
        1, mp_context=multiprocessing.get_context("spawn"), initializer=_end_with_parent
    )


def _end_with_parent() -> None:
    """Let this process end when its parent does, even one that was killed."""
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class _Outbox:
    """What one connection still has to send: every message in order, but of states only the newest.

    It begins with the welcome; what was on its way to the connection before is not for this one.
    """

    def __init__(self) -> None:
        self._messages: deque[Message] = deque(maxlen=OUTBOX_MESSAGES)
        self._state: State | None = None
        self._welcomed = False
        self._filled = asyncio.Event()

    def push(self, message: Message) -> None:
        self._welcomed = self._welcomed or isinstance(message, Welcome)
        if not self._welcomed:
            return
        if isinstance(message, State):
            self._state = message
        else:
            self._messages.append(message)
        self._filled.set()

    async def next(self) -> Message:
        while True:
            if self._messages:
                return self._messages.popleft()
            if self._state is not None:
                state, self._state = self._state, None
                return state
            self._filled.clear()
            await self._filled.wait()


class Hub:
    """Between the simulation's thread and the one connection of the participant."""

    def __init__(self) -> None:
        self._events: asyncio.AbstractEventLoop | None = None
        self._outbox: _Outbox | None = None

    @property
    def taken(self) -> bool:
        """Whether a participant is connected."""
        return self._outbox is not None

    def send(self, message: Message) -> None:
        """Send a message to the participant, if there is one; called from the simulation's thread."""
        events, outbox = self._events, self._outbox
        if events is not None and outbox is not None:
            with contextlib.suppress(RuntimeError):  # the event loop closed meanwhile
                events.call_soon_threadsafe(outbox.push, message)

    @contextlib.contextmanager
    def connection(self):
        """Take the participant's place; gives the outbox to send from."""
        self._events, self._outbox = asyncio.get_running_loop(), _Outbox()
        try:
            yield self._outbox
        finally:
            self._outbox = None


def create_app(
    loop: RealTimeLoop, hub: Hub, token: str, hosts: list[str], renderer: SceneRenderer
) -> FastAPI:
    """The web application of one session.

    Args:
        loop: the simulation that runs.
        hub: where its messages go.
        token: what a client must present.
        hosts: the host names under which the server may be addressed.
        renderer: renders the scenes.
    """
    app = FastAPI(openapi_url=None)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)

    @app.get("/scenes/{number}.glb")
    async def scene(number: int, request: Request) -> Response:
        if not _same(request.headers.get("authorization", ""), f"Bearer {token}"):
            raise HTTPException(401, "the address of this page lacks the session's token")
        known = loop.session.scenes
        if not 0 <= number < len(known):
            raise HTTPException(404, f"no scene {number}; there are {len(known)}")
        try:
            return Response(await renderer.glb(number, *known[number]), media_type="model/gltf-binary")
        except Exception as error:  # whatever happened in the other process
            raise HTTPException(500, f"scene {number} cannot be rendered: {error!r}") from error

    @app.websocket("/ws")
    async def participant(socket: WebSocket) -> None:
        if not _from_own_page(socket):
            await socket.close(4403)
            return
        await socket.accept()
        if await _welcome(socket, token, hub):
            await _converse(socket, loop, hub)

    app.mount("/", StaticFiles(directory=STATIC, html=True))
    return app


def _from_own_page(socket: WebSocket) -> bool:
    """Whether the page that opened the connection came from this server; programs send no origin."""
    origin = socket.headers.get("origin")
    return origin is None or urlsplit(origin).netloc == socket.headers.get("host")


async def _welcome(socket: WebSocket, token: str, hub: Hub) -> bool:
    """Whether the first message admits the client; if not, it is told why."""
    refusal = 4400, f"the first message must be a hello of protocol {messages.PROTOCOL}"
    with contextlib.suppress(msgspec.DecodeError, TimeoutError, KeyError, WebSocketDisconnect):
        hello = messages.decode_client(await asyncio.wait_for(socket.receive_bytes(), HELLO_TIMEOUT_S))
        if isinstance(hello, Hello) and hello.protocol == messages.PROTOCOL:
            if not _same(hello.token, token):
                refusal = (
                    4401,
                    "the address of this page lacks the session's token; open the one that the server printed",
                )
            elif hub.taken:
                refusal = 4409, "a participant is already connected; one at a time"
            else:
                return True
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_bytes(messages.encode(messages.Problem(message=refusal[1])))
        await socket.close(*refusal)
    return False


async def _converse(socket: WebSocket, loop: RealTimeLoop, hub: Hub) -> None:
    with hub.connection() as outbox:
        loop.greet()
        tasks = [
            asyncio.create_task(_receive(socket, loop, outbox)),
            asyncio.create_task(_send(socket, outbox)),
        ]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    loop.post(Disconnected())


async def _receive(socket: WebSocket, loop: RealTimeLoop, outbox: _Outbox) -> None:
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            frame = await socket.receive()
            if frame["type"] == "websocket.disconnect":
                return
            message = _understand(frame.get("bytes"), outbox.push)
            if message is not None:
                await _until(lambda: not loop.full)
                loop.post(message)


async def _until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(TICK_S)


def _understand(data: bytes | None, complain: Callable[[Message], None]) -> ClientMessage | None:
    if data is None:
        complain(messages.Problem(message=f"text is not understood; send MessagePack of type {CLIENT_TYPES}"))
        return None
    try:
        return messages.decode_client(data)
    except msgspec.DecodeError as error:
        complain(messages.Problem(message=f"not a message ({error}); the types are {CLIENT_TYPES}"))
        return None


async def _send(socket: WebSocket, outbox: _Outbox) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):
        while True:
            await socket.send_bytes(messages.encode(await outbox.next()))


def _same(given: str, wanted: str) -> bool:
    return secrets.compare_digest(given.encode(), wanted.encode())


class LiveServer(Generic[S]):
    """A session with its loop and its web server, as a context manager; ``port`` 0 takes a free one."""

    def __init__(self, make_session: Callable[[Callable[[Message], None]], S], host: str, port: int) -> None:
        """Bind the port and make the session.

        Args:
            make_session: makes the session from the function that sends its messages.
            host: the address to listen on.
            port: the port to listen on.

        Raises:
            ServerError: when the client is not built or the port cannot be had.
        """
        if not (STATIC / "index.html").exists():
            raise ServerError("the browser client is not built; run `make client`")
        self._socket = _bind(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        self.token = secrets.token_urlsafe(16)
        hub = Hub()
        try:
            self.loop = RealTimeLoop(make_session(hub.send))
        except BaseException:
            self._socket.close()
            raise
        self._renderer = SceneRenderer()
        app = create_app(self.loop, hub, self.token, list(LOOPBACK), self._renderer)
        configuration = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            ws_max_size=MAX_MESSAGE_BYTES,
            ws_ping_interval=PING_INTERVAL_S,
            ws_ping_timeout=PING_TIMEOUT_S,
            timeout_graceful_shutdown=FAREWELL_S,
            ws_per_message_deflate=False,
        )
        self._server = uvicorn.Server(configuration)
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True
        )

    @property
    def session(self) -> S:
        """The session that it serves."""
        return self.loop.session

    @property
    def url(self) -> str:
        """The address of the participant's page, with its token in the fragment, which browsers do not send."""
        name = "localhost" if self.host == "127.0.0.1" else self.host
        return f"http://{name}:{self.port}/#token={self.token}"

    def __enter__(self) -> "LiveServer[S]":
        self.loop.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._server.should_exit = True
        self._thread.join()
        self.loop.stop()
        self._renderer.close()
        self._socket.close()

    def wait(self) -> None:
        """Wait until the server ends or the simulation fails."""
        while self._thread.is_alive() and self.loop.error is None:
            self._thread.join(0.5)


def _bind(host: str, port: int) -> socket.socket:
    if host not in LOOPBACK:
        raise ServerError(
            f"--host {host} is not this machine's own address; allowed: {' and '.join(LOOPBACK)}, which a "
            "headset reaches over USB, because browsers allow VR only on secure pages"
        )
    listener = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        raise ServerError(
            f"cannot listen on {host}:{port} ({error.strerror}); choose another --port; 0 takes a free one"
        ) from error
    return listener
