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

    def bearer(self, headers: Headers) -> Role | None:
        """Whose token a request presents."""
        scheme, _, token = headers.get("authorization", "").partition(" ")
        return self.role(token) if scheme == "Bearer" else None


class OwnPagesOnly:
    """Refuses requests and sockets that a page of another origin sends; programs name no origin.

    No answer of the server may be framed either, but for the picture that the dashboard shows. The dashboard itself
    may load and reach nothing but this server, and makes no markup from texts.
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
        await self._app(scope, receive, _restricted(send, scope["path"]))


def _is_own(headers: Headers) -> bool:
    origin = headers.get("origin")
    return origin is None or urlsplit(origin).netloc == headers.get("host")


def _restricted(send: Send, path: str) -> Send:
    async def send_restricted(message) -> None:
        if message["type"] == "http.response.start":
            policy = b"content-security-policy", _content_policy(path).encode()
            message["headers"] = [*message["headers"], policy, *_RESTRICTIONS]
        await send(message)

    return send_restricted


def _content_policy(path: str) -> str:
    if path.startswith("/dashboard"):
        return _DASHBOARD_POLICY
    ancestors = "'self'" if path == "/spectator" else "'none'"
    return f"frame-ancestors {ancestors}; object-src 'none'; base-uri 'none'"


_DASHBOARD_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; frame-src 'self'; "
    "form-action 'none'; frame-ancestors 'none'; base-uri 'none'; require-trusted-types-for 'script'"
)
_RESTRICTIONS = (
    (b"referrer-policy", b"no-referrer"),
    (b"x-content-type-options", b"nosniff"),
)
