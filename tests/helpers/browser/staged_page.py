"""The client's pages in a browser without a server, with stored messages of a session."""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from playwright.sync_api import Page, Route, WebSocketRoute

import avrgym.vr
from avrgym.vr.protocol import messages

STATIC_FOLDER = Path(avrgym.vr.__file__).parent / "static"
ADDRESS = "http://localhost:9"
"""Playwright answers every request to this address."""
_TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml"}


class StagedPage:
    """A page that receives messages. ``sent`` contains its own messages, without poses and receipts."""

    def __init__(self, page: Page, said: Sequence[messages.Message], glb: bytes | None = None) -> None:
        """Send ``said`` after the page's hello. ``glb`` is the file of every scene."""
        self.page, self._said, self._glb = page, said, glb
        self.sent: list[dict] = []
        self.answers: dict[str, Callable[[], object]] = {}
        self._sockets: list[WebSocketRoute] = []
        page.route(f"{ADDRESS}/**", self._answer)
        page.route_web_socket(lambda url: "localhost:9" in url, self._connected)

    def open(self, name: str = "index.html", query: str = "?detail=light") -> Page:
        """Open one of the client's pages."""
        self.page.goto(f"{ADDRESS}/{name}{query}#token=t")
        return self.page

    def send(self, *said: messages.Message) -> None:
        """Send messages to the page."""
        for message in said:
            self._sockets[-1].send(messages.encode_message(message))

    def kinds(self) -> list[str]:
        """Return the types of the page's messages, and the names of its commands."""
        return [message.get("name", message["type"]) for message in self.sent]

    def _connected(self, socket: WebSocketRoute) -> None:
        self._sockets.append(socket)
        socket.on_message(lambda data: self._heard(socket, data))

    def _heard(self, socket: WebSocketRoute, data: str | bytes) -> None:
        message = msgspec.msgpack.decode(data if isinstance(data, bytes) else data.encode())
        if message["type"] == "hello":
            for each in self._said:
                socket.send(messages.encode_message(each))
        if message["type"] not in ("tracking", "receipt"):
            self.sent.append(message)

    def _answer(self, route: Route) -> None:
        path = route.request.url.removeprefix(ADDRESS).partition("?")[0].partition("#")[0].lstrip("/")
        if path.endswith(".glb") and self._glb is not None:
            return route.fulfill(body=self._glb, content_type="model/gltf-binary")
        for name, answer in self.answers.items():
            if path.endswith(name):
                return route.fulfill(body=msgspec.json.encode(answer()), content_type="application/json")
        file = STATIC_FOLDER / ("index.html" if path == "spectator" else path)
        if not file.is_file():
            return route.fulfill(status=404)
        return route.fulfill(path=file, content_type=_TYPES.get(file.suffix, "application/octet-stream"))
