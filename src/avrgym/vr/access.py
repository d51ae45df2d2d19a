"""Who may come in: tokens by role, the names of the server, and pages of other origins kept out."""

import secrets
from dataclasses import dataclass
from urllib.parse import urlsplit

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from avrgym.vr.messages import Role

TOKEN_BYTES = 16
REFUSED_ORIGIN = "this page comes from elsewhere; open the address that the server printed"


@dataclass(frozen=True)
class Tokens:
    """One secret for each role; each opens only what its role may do."""

    participant: str
    experimenter: str
    spectator: str

    @classmethod
    def new(cls) -> "Tokens":
        """Fresh secrets."""
        return cls(*(secrets.token_urlsafe(TOKEN_BYTES) for _ in range(3)))

    def role(self, token: str) -> Role | None:
        """Whose token this is."""
        found: Role | None = None
        for role in ("participant", "experimenter", "spectator"):
            if secrets.compare_digest(token.encode(), getattr(self, role).encode()):
                found = role
        return found


class OwnPagesOnly:
    """Refuses requests and sockets that a page of another origin sends; programs name no origin.

    No answer of the server may be framed by another page either.
    """

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request or socket."""
        if scope["type"] in ("http", "websocket") and not _is_own(Headers(scope=scope)):
            refusal = (
                PlainTextResponse(REFUSED_ORIGIN, 403) if scope["type"] == "http" else WebSocketClose(4403)
            )
            await refusal(scope, receive, send)
            return
        await self._app(scope, receive, _unframed(send))


def _is_own(headers: Headers) -> bool:
    origin = headers.get("origin")
    return origin is None or urlsplit(origin).netloc == headers.get("host")


def _unframed(send: Send) -> Send:
    async def send_unframed(message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message["headers"], *_FRAMELESS]
        await send(message)

    return send_unframed


_FRAMELESS = (
    (b"content-security-policy", b"frame-ancestors 'none'; object-src 'none'; base-uri 'none'"),
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
