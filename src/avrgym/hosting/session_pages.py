"""Routes of the host's web servers for running sessions: pages, files, scenes and sounds."""

from http.client import HTTPConnection
from http.client import HTTPException as HttpError

from fastapi import FastAPI, HTTPException, Request, Response
from fastapi.responses import FileResponse

from avrgym.hosting.session_pool import SessionPool
from avrgym.vr.server.web_server import STATIC_FOLDER, make_page_endpoint

SESSION_PAGE = "index.html"
SESSION_RESPONSE_TIMEOUT_S = 30.0


def add_session_pages(app: FastAPI, pool: SessionPool, path: str = "") -> None:
    """Add the routes of sessions: the page at ``path``, its files, and the scenes and sounds of the session's server.

    ``tunnel`` forwards the WebSockets.
    """

    def address_of(session_id: str) -> tuple[str, int]:
        session = pool.find_session(session_id)
        if session is None or session.server_address is None:
            raise HTTPException(404, "this session is not running; open the study's page to start a session")
        return session.server_address

    app.get(f"/session/{{session_id}}/{path}")(
        make_page_endpoint(SESSION_PAGE)
    )  # the page also explains that a session has ended

    @app.get("/session/{session_id}/assets/{name}")
    async def session_file(session_id: str, name: str) -> Response:
        if "/" in name or not (STATIC_FOLDER / "assets" / name).is_file():
            raise HTTPException(404, f"no file {name}; reload the page")
        return FileResponse(STATIC_FOLDER / "assets" / name)

    app.get("/session/{session_id}/favicon.svg")(make_page_endpoint("favicon.svg"))

    @app.get("/session/{session_id}/scenes/{name}")
    def scene(session_id: str, name: str, request: Request) -> Response:
        return _passed_on(address_of(session_id), f"/scenes/{name}", request)

    @app.get("/session/{session_id}/sounds/{language}/{name}")
    def sound(session_id: str, language: str, name: str, request: Request) -> Response:
        return _passed_on(address_of(session_id), f"/sounds/{language}/{name}", request)


FORWARDED_REQUEST_HEADERS = ("authorization", "if-none-match")
FORWARDED_RESPONSE_HEADERS = ("content-type", "etag", "cache-control", "vary")


def _passed_on(address: tuple[str, int], path: str, request: Request) -> Response:
    """Returns the response of the session's server at ``address`` to a GET request for ``path``."""
    if not all(character.isalnum() or character in "/._-" for character in path):
        raise HTTPException(404, f"no file {path}; reload the page")
    headers = {name: request.headers[name] for name in FORWARDED_REQUEST_HEADERS if name in request.headers}
    headers["host"] = f"localhost:{address[1]}"
    connection = HTTPConnection(*address, timeout=SESSION_RESPONSE_TIMEOUT_S)
    try:
        connection.request("GET", path, headers=headers)
        response = connection.getresponse()
        passed = {name: value for name in FORWARDED_RESPONSE_HEADERS if (value := response.headers.get(name))}
        return Response(response.read(), response.status, passed)
    except (OSError, HttpError):
        raise HTTPException(503, "the server of this session is starting; wait a few seconds") from None
    finally:
        connection.close()
