"""Security headers of all responses, and the response to unexpected errors."""

import logging
import traceback
from contextlib import suppress
from pathlib import Path

from starlette.requests import ClientDisconnect
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketDisconnect

PACKAGE_FOLDER = str(Path(__file__).parents[2])
EMBEDDABLE_PAGE = "/spectator"
"""The only page that may be in an HTML frame. The dashboard shows it."""
HASHED_FILES_PATH = "/assets/"
"""Folder of files with a content hash in the file name. Browsers may cache these files without a time limit."""
CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self' blob:; "
    "frame-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors {ancestors}; "
    "trusted-types avrgym; require-trusted-types-for 'script'"
)
"""Content security policy: pages load only from this server and create no HTML from text. Blobs are allowed for
textures of scenes."""
PERMISSIONS_POLICY = (
    "xr-spatial-tracking=(self), camera=(), display-capture=(), geolocation=(), microphone=(), payment=()"
)
INTERNAL_ERROR_CLOSE_CODE = 1011
"""Closing code of a WebSocket after an internal error of the server (RFC 6455)."""

_log = logging.getLogger(__name__)


def make_security_headers(path: str) -> dict[str, str]:
    """Returns the security headers for a response to this path. The response's own headers have priority."""
    ancestors, frames = ("'self'", "SAMEORIGIN") if path == EMBEDDABLE_PAGE else ("'none'", "DENY")
    return {
        "content-security-policy": CONTENT_SECURITY_POLICY.format(ancestors=ancestors),
        "x-frame-options": frames,
        "x-content-type-options": "nosniff",
        "referrer-policy": "no-referrer",
        "permissions-policy": PERMISSIONS_POLICY,
        "cross-origin-opener-policy": "same-origin",
        "cross-origin-resource-policy": "same-origin",
        "cache-control": "no-store",
    }


class SecurityHeadersMiddleware:
    """Middleware that adds the security headers to every response.

    An unexpected error becomes a plain 500 response and one log line with its type and location. The line contains no
    data of the request, which may contain a token or a name.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or WebSocket, and handle an unexpected error."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        answer = _Response(scope, receive, send)
        try:
            await self._app(scope, receive, answer.send)
        except (ClientDisconnect, WebSocketDisconnect):
            return
        except Exception as error:
            route = getattr(scope.get("route"), "path", "an unknown route")
            _log.error("%s of %s failed: %s", scope["type"], route, _describe(error))
            await answer.fail()


class _Response:
    """One HTTP response or WebSocket handshake, sent with the security headers."""

    def __init__(self, scope: Scope, receive: Receive, send: Send) -> None:
        self._scope, self._receive, self._send = scope, receive, send
        self._begun = False

    async def send(self, message: Message) -> None:
        """Send one message of the response. If a WebSocket closes before it opens, send an HTTP response instead."""
        if message["type"] == "websocket.close" and not self._begun:
            await self._refuse("this address has no WebSocket", 403)
            return
        if message["type"].endswith("http.response.start"):
            message["headers"] = _completed(message["headers"], self._scope["path"], message["status"])
        self._begun = True
        await self._send(message)

    async def fail(self) -> None:
        """Report the error to the client if the response is not complete."""
        with suppress(OSError, RuntimeError):  # the client has disconnected, or the response is complete
            if not self._begun:
                await self._refuse("Internal Server Error", 500)
            elif self._scope["type"] == "websocket":
                await self.send(
                    {"type": "websocket.close", "code": INTERNAL_ERROR_CLOSE_CODE, "reason": "internal error"}
                )

    async def _refuse(self, words: str, status: int) -> None:
        await PlainTextResponse(words, status)(self._scope, self._receive, self.send)


def _completed(given: list[tuple[bytes, bytes]], path: str, status: int) -> list[tuple[bytes, bytes]]:
    present = {name.lower() for name, _ in given}
    added = make_security_headers(path)
    if path.startswith(HASHED_FILES_PATH) and status in (200, 304):
        added["cache-control"] = "public, max-age=31536000, immutable"
    return [*given, *((n.encode(), v.encode()) for n, v in added.items() if n.encode() not in present)]


def _describe(error: Exception) -> str:
    """Returns the type and location of an error, without its message, which may contain a token or a name."""
    walked = list(traceback.walk_tb(error.__traceback__))[1:]  # the first frame caught the error
    frames = [(frame.f_code.co_filename, line) for frame, line in walked]
    own = [place for place in frames if place[0].startswith(PACKAGE_FOLDER)]
    file, line = (own or frames)[-1]
    return f"{type(error).__name__} in {Path(file).name}, line {line}"
