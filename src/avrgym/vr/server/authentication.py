"""Authentication: tokens by role, and the rejection of requests from pages of other origins."""

import secrets
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import msgspec
from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Receive, Scope, Send

from avrgym.system.files import PRIVATE_FILE_MODE, make_private_folder, write_atomically
from avrgym.vr.protocol.messages import Language, Role

TOKEN_BYTES = 16
Token = Annotated[str, msgspec.Meta(min_length=TOKEN_BYTES, max_length=128, pattern="^[A-Za-z0-9_-]+$")]
OTHER_ORIGIN_TEXT = "this page comes from another server; open the address that the server printed"


@dataclass(frozen=True)
class AuthenticatedClient:
    """An authenticated client: the role of its token, and the experimenter's name.

    ``user_name`` is empty if the token is not personal.
    """

    role: Role
    user_name: str = ""


@dataclass(frozen=True)
class TokenRejection:
    """The reason for rejecting a token: closing code of the WebSocket, message, and the participant's language."""

    close_code: int
    message: str
    language: Language | None = None


MISSING_TOKEN_REJECTION = TokenRejection(
    4401, "this address contains no token; open the complete address that the server printed"
)
OUTDATED_TOKEN_REJECTION = TokenRejection(
    4403, "this address is from an earlier start of the server; open the address that it printed last"
)
EXPIRED_LINK_REJECTION = TokenRejection(
    4410, "this link has expired with its session; open the link of the current session"
)
CODE_REQUIRED_REJECTION = TokenRejection(
    4411, "this page needs the link of a session, or the code that the dashboard shows"
)
"""WebSocket closing codes. ``client/src/session/display-state.ts`` maps them to texts in the participant's language."""


@dataclass(frozen=True)
class Tokens:
    """The secret token of each role. A client with this token has the role."""

    participant: Token
    experimenter: Token
    spectator: Token
    demonstrator: Token = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES), kw_only=True)

    @classmethod
    def generate(cls) -> "Tokens":
        """Returns new random secrets, one for each role."""
        return cls(*(secrets.token_urlsafe(TOKEN_BYTES) for _ in range(3)))

    @classmethod
    def load_or_create(cls, path: Path) -> "Tokens":
        """Read the tokens from a private file, or create the file with new tokens.

        The addresses of pages therefore remain valid after a restart.

        Raises:
            ValueError: if the file contains no tokens.
        """
        data = path.read_bytes() if path.exists() else b""
        try:
            tokens = msgspec.json.decode(data, type=cls) if path.exists() else cls.generate()
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ValueError(f"{path} contains no tokens: {error}; delete it to create new ones") from None
        complete = msgspec.json.encode(tokens)
        if data != complete:  # new, or of a version without some role
            make_private_folder(path.parent)
            write_atomically(path, complete, PRIVATE_FILE_MODE)
        return tokens

    def find_client_by_token(self, token: str) -> AuthenticatedClient | None:
        """Returns the client with this token; ``None`` for an unknown token."""
        found: AuthenticatedClient | None = None
        for role in ("participant", "experimenter", "spectator", "demonstrator"):
            if secrets.compare_digest(token.encode(), getattr(self, role).encode()):
                found = AuthenticatedClient(role)
        return found

    def find_rejection(self, token: str) -> TokenRejection:
        """Returns the reason for rejecting an unknown token, or a token of another role."""
        return OUTDATED_TOKEN_REJECTION if token else MISSING_TOKEN_REJECTION

    def authenticate_request(self, headers: Headers) -> AuthenticatedClient | None:
        """Returns the client with the bearer token of a request; ``None`` without a known token."""
        scheme, _, token = headers.get("authorization", "").partition(" ")
        return self.find_client_by_token(token) if scheme == "Bearer" else None


class SameOriginMiddleware:
    """Middleware that rejects requests and WebSockets from pages of other origins.

    Requests without an origin header come from programs and are accepted.
    """

    def __init__(self, app: ASGIApp, origins: frozenset[str] | None = None) -> None:
        """``origins``: the allowed origins; default: the address of the request."""
        self._app, self._origins = app, origins

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass one request or WebSocket to the application, or reject it."""
        if scope["type"] in ("http", "websocket"):
            headers = Headers(scope=scope)
            allowed = self._origins or {_own_origin(headers, scope["scheme"])}
            if headers.get("origin") not in (None, *allowed):
                await PlainTextResponse(OTHER_ORIGIN_TEXT, 403)(scope, receive, send)
                return
        await self._app(scope, receive, send)


def _own_origin(headers: Headers, scheme: str) -> str:
    page_scheme = {"ws": "http", "wss": "https"}.get(scheme, scheme)
    return f"{page_scheme}://{headers.get('host')}"
