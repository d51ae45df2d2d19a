"""The VR server: the client's pages, the scenes, and the WebSockets of participant and watchers.

Watchers are experimenters, caregivers, demonstrators and spectators.
"""

import gc
import secrets
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, Generic

from fastapi import FastAPI, HTTPException, Request, Response, WebSocket
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

from avrgym.vr.protocol.messages import Message
from avrgym.vr.scene.export_process import SceneExporter
from avrgym.vr.server.authentication import AuthenticatedClient, SameOriginMiddleware, Tokens
from avrgym.vr.server.broadcast import Broadcast
from avrgym.vr.server.certificate import Certificate
from avrgym.vr.server.code_exchange import make_code_endpoint
from avrgym.vr.server.connection import (
    PARTICIPANT_CHANNEL,
    WATCHER_CHANNEL,
    CommandRecorder,
    serve_connection,
)
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.network_addresses import ALL_INTERFACES, LOOPBACK_HOSTS
from avrgym.vr.server.real_time_loop import RealTimeLoop, S
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.server.sound_files import add_sound_route
from avrgym.vr.server.web_server import (
    STATIC_FOLDER,
    ServerError,
    WebServer,
    check_client_page,
    make_page_endpoint,
    open_listener,
)

THREAD_SWITCH_INTERVAL_S = 0.0001
"""Python's thread switch interval in seconds. The default value, 5 ms, would be half of a tick."""


def create_app(
    loop: RealTimeLoop[S],
    broadcast: Broadcast,
    tokens: Tokens,
    limiter: ConnectionLimiter,
    hosts: list[str],
    exporter: SceneExporter,
    record: CommandRecorder,
    study: FastAPI | None = None,
    links: SessionLinks | None = None,
    sounds: Path | None = None,
) -> FastAPI:
    """Returns the web application of one session.

    Args:
        loop: the running simulation.
        broadcast: sends the simulation's messages to the connections.
        tokens: tokens that authenticate clients.
        limiter: limits connections.
        hosts: allowed host names of requests.
        exporter: exports the scenes.
        record: called with the first message (``Hello``) of each watcher, and with each of their commands.
        study: the API of the experimenter's dashboard.
        links: links of a study's participants, for the exchange of codes.
        sounds: folder of sound files, see ``sound_files``.
    """
    start = secrets.token_hex(8)  # distinguishes scenes of this server from scenes of an earlier start
    app = FastAPI(openapi_url=None)
    app.add_middleware(SameOriginMiddleware)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=hosts)

    @app.get("/scenes/{number}.glb")
    async def scene(number: int, request: Request) -> Response:
        if tokens.authenticate_request(request.headers) is None:
            raise HTTPException(401, "the request has no valid token; send one in the Authorization header")
        known, version = loop.session.scenes, f'"{start}-{number}"'
        if not 0 <= number < len(known):
            raise HTTPException(404, f"no scene {number}; allowed: 0 to {len(known) - 1}")
        caching = {"etag": version, "cache-control": "private, no-cache", "vary": "authorization"}
        if request.headers.get("if-none-match") == version:
            return Response(status_code=304, headers=caching)
        try:
            glb = await exporter.wait_for_glb(number, *known[number])
        except Exception as error:  # any error of the export process
            raise HTTPException(
                500, f"scene {number} cannot be exported: {error!r}; restart the server"
            ) from error
        return Response(glb, media_type="model/gltf-binary", headers=caching)

    @app.websocket("/ws")
    async def participant(socket: WebSocket) -> None:
        await serve_connection(socket, PARTICIPANT_CHANNEL, tokens, limiter, broadcast, loop, record)

    @app.websocket("/watch")
    async def watch(socket: WebSocket) -> None:
        await serve_connection(socket, WATCHER_CHANNEL, tokens, limiter, broadcast, loop, record)

    app.get("/spectator")(make_page_endpoint("index.html"))
    app.get("/demonstrator")(make_page_endpoint("demonstrator.html"))
    add_sound_route(app, tokens, sounds)
    if links is not None:
        app.post("/link")(make_code_endpoint(links))

    if study is not None:
        app.mount("/study", study)
        app.get("/dashboard")(make_page_endpoint("dashboard.html"))
        app.get("/caregiver")(make_page_endpoint("caregiver.html"))

    app.mount("/", StaticFiles(directory=STATIC_FOLDER, html=True))
    return app


class LiveServer(Generic[S]):
    """A session with its real-time loop and its web server, as a context manager."""

    def __init__(
        self,
        make_session: Callable[[Callable[[Message], None]], S],
        host: str,
        port: int,
        certificate: Certificate | None = None,
        study: Callable[[Tokens, S], FastAPI] | None = None,
        tokens: Tokens | None = None,
        record: Callable[[S, AuthenticatedClient, Any], None] = lambda session, caller, message: None,
        links: SessionLinks | None = None,
        sounds: Path | None = None,
        *,
        behind_proxy: bool = False,
    ) -> None:
        """Bind the port and create the session.

        Args:
            make_session: creates the session; its argument is the function that sends messages.
            host: the address to listen on; without a certificate only a loopback address.
            port: the port to listen on; 0 selects a free port.
            certificate: certificate for TLS, with the host names of this computer.
            study: creates the API of the experimenter's dashboard from tokens and session; see
                ``study.dashboard.application``.
            tokens: tokens that authenticate clients; default: new tokens.
            record: called with the first message (``Hello``) of each watcher, and with each of their commands.
            links: links of a study's participants. A participant is disconnected when the link expires.
            sounds: folder of sound files, see ``sound_files``.
            behind_proxy: whether a reverse proxy forwards all connections and provides TLS.

        Raises:
            ServerError: if the client is not built or the port is not available.
        """
        check_client_page("index.html")
        listener = open_listener(host, port, certificate, behind_proxy=behind_proxy)
        self.host, self.port = host, int(listener.getsockname()[1])
        self.certificate = certificate
        self.tokens = tokens or Tokens.generate()
        self._broadcast = broadcast = Broadcast()
        if links is not None:
            links.on_expiry = broadcast.close_participant_connection
        try:
            self.loop = RealTimeLoop(make_session(broadcast.send), broadcast.send)
        except BaseException:
            listener.close()
            raise
        self._exporter = SceneExporter()
        hosts = [*LOOPBACK_HOSTS, *(certificate.host_names if certificate else ())]
        pages = study(self.tokens, self.session) if study else None
        limiter = ConnectionLimiter(listener, self.tokens)
        of_session = partial(record, self.session)
        self.app = create_app(
            self.loop,
            broadcast,
            self.tokens,
            limiter,
            hosts,
            self._exporter,
            of_session,
            pages,
            links,
            sounds,
        )
        self._web = WebServer(self.app, limiter, certificate)

    @property
    def session(self) -> S:
        """The session or viewer that this server runs."""
        return self.loop.session

    @property
    def has_participant(self) -> bool:
        """Whether the connection of a participant is open."""
        return self._broadcast.has_participant

    def send(self, message: Message) -> None:
        """Send a message to all connections whose role receives it."""
        self._broadcast.send(message)

    @property
    def participant_url(self) -> str:
        """The address of the participant's page on this computer.

        The token is in the fragment, which browsers do not send.
        """
        return self.list_page_urls()[0]

    def list_page_urls(self, page: str = "", token: str | None = None) -> list[str]:
        """Returns the addresses of a page: first the loopback address, then the addresses in the local network."""
        names = ["localhost"] if self.host in (*LOOPBACK_HOSTS, ALL_INTERFACES) else []
        names += self.certificate.host_names if self.certificate else ()
        scheme = "https" if self.certificate else "http"
        return [
            f"{scheme}://{name}:{self.port}/{page}#token={token or self.tokens.participant}" for name in names
        ]

    def list_participant_urls_without_token(self) -> list[str]:
        """Returns the addresses of the participant's page without a token. On this page, a participant enters a
        session's code."""
        return [url.partition("#")[0] for url in self.list_page_urls()]

    def __enter__(self) -> "LiveServer[S]":
        gc.collect()
        gc.freeze()  # excludes permanent objects from later collections
        gc.disable()  # the loop collects garbage at rest
        self._switch_interval_s = sys.getswitchinterval()
        sys.setswitchinterval(THREAD_SWITCH_INTERVAL_S)
        self.loop.start()
        self._web.start()
        return self

    def __exit__(self, failure: type[BaseException] | None, *_: object) -> None:
        self._broadcast.close_all_connections("the server has stopped")
        self._web.stop()
        self.loop.stop()
        self._exporter.close()
        sys.setswitchinterval(self._switch_interval_s)
        gc.enable()
        gc.unfreeze()
        if failure in (None, KeyboardInterrupt) and self.loop.error is not None:
            raise ServerError(str(self.loop.error)) from self.loop.error

    def export_newest_scene(self) -> None:
        """Export the newest scene before a browser requests it. Without a scene, only start the export process."""
        scenes = self.session.scenes
        if scenes:
            self._exporter.start_export(len(scenes) - 1, *scenes[-1])
        else:
            self._exporter.start_process()

    def wait(self) -> None:
        """Wait until the server stops or the simulation fails."""
        while self._web.is_running and self.loop.error is None:
            self._web.wait(0.5)
