"""Local web server of a replay. It serves the page, the scene, the timeline and the poses."""

from functools import cache

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.staticfiles import StaticFiles
from starlette.middleware.trustedhost import TrustedHostMiddleware

from avrgym.recording.reader import Recording
from avrgym.replay.timeline import Timeline, export_recorded_scene
from avrgym.vr.server.authentication import SameOriginMiddleware, Tokens
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS
from avrgym.vr.server.request_body import make_json_response
from avrgym.vr.server.web_server import (
    STATIC_FOLDER,
    WebServer,
    check_client_page,
    make_page_endpoint,
    open_listener,
)


def create_replay_app(recording: Recording, timeline: Timeline, poses: bytes, tokens: Tokens) -> FastAPI:
    """Returns the web application. Requests for data need a token, because movements can identify people."""
    app = FastAPI(openapi_url=None)
    app.add_middleware(SameOriginMiddleware)
    app.add_middleware(TrustedHostMiddleware, allowed_hosts=list(LOOPBACK_HOSTS))
    rendered = cache(lambda: export_recorded_scene(recording))

    def check(request: Request) -> None:
        if tokens.authenticate_request(request.headers) is None:
            raise HTTPException(
                401,
                "this address does not contain the replay's token; open the address from `avrgym replay`",
            )

    @app.get("/timeline")
    async def read_timeline(request: Request) -> Response:
        check(request)
        return make_json_response(timeline)

    @app.get("/poses")
    async def read_poses(request: Request) -> Response:
        check(request)
        return Response(poses, media_type="application/octet-stream")

    @app.get("/scenes/0.glb")
    def scene(request: Request) -> Response:
        check(request)
        return Response(rendered(), media_type="model/gltf-binary")

    app.get("/replay")(make_page_endpoint("replay.html"))
    app.mount("/", StaticFiles(directory=STATIC_FOLDER))
    return app


class ReplayServer:
    """Context manager that serves one replay on this computer. ``port`` 0: any free port."""

    def __init__(self, recording: Recording, timeline: Timeline, poses: bytes, port: int) -> None:
        """Bind the port, and create the web application.

        Raises:
            ServerError: if the client is not built, or if another program uses the port.
        """
        check_client_page("replay.html")
        listener = open_listener(LOOPBACK_HOSTS[0], port)
        self.port = int(listener.getsockname()[1])
        self.tokens = Tokens.generate()
        app = create_replay_app(recording, timeline, poses, self.tokens)
        self._web = WebServer(app, ConnectionLimiter(listener, self.tokens))

    @property
    def url(self) -> str:
        """The URL of the page. The token is in the fragment, which browsers do not send."""
        return f"http://localhost:{self.port}/replay#token={self.tokens.spectator}"

    def __enter__(self) -> "ReplayServer":
        self._web.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._web.stop()

    def wait(self) -> None:
        """Wait until the web server ends, for example after Ctrl+C."""
        while self._web.is_running:
            self._web.wait(0.5)
