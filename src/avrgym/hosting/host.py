"""The host of a study: the public server, the experimenter's server, and the processes of the sessions."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from urllib.parse import urlsplit

from avrgym.hosting.computers import Computer
from avrgym.hosting.data_requests import DeletionThread
from avrgym.hosting.experimenter_app import make_experimenter_app
from avrgym.hosting.headset_codes import HeadsetCodes
from avrgym.hosting.host_state import HostState
from avrgym.hosting.participant_app import ParticipantRequestContext, make_participant_app
from avrgym.hosting.participant_tokens import ParticipantTokens
from avrgym.hosting.public_links import parse_public_address
from avrgym.hosting.rate_limits import find_client_address
from avrgym.hosting.session_pool import SessionPool
from avrgym.hosting.settings import read_host_settings
from avrgym.hosting.tunnel import TunnelFactory, TunnelRules
from avrgym.study.dashboard.study_tokens import StudyTokens
from avrgym.study.people.experimenters import ExperimenterTokens
from avrgym.study.storage.identity_file import IDENTITY_FOLDER as PRIVATE
from avrgym.study.storage.remote_recordings import RecordingUploader
from avrgym.study.storage.store import StudyStore
from avrgym.system.files import make_private_folder
from avrgym.system.locks import lock_folder
from avrgym.vr.server.connection_limits import ConnectionLimiter
from avrgym.vr.server.network_addresses import LOOPBACK_HOSTS
from avrgym.vr.server.session_links import SessionLinks
from avrgym.vr.server.web_server import WebServer, check_client_page, open_listener

MAX_PARTICIPANT_CONNECTIONS = 1000
HOST_LOCK_FILE = "host.lock"
"""File in the study's private folder that the host locks. The lock prevents a second host of the same study."""


class StudyHost:
    """Context manager: a hosted study with both servers. ``store``: the open study. ``pool``: its sessions."""

    def __init__(
        self,
        store: StudyStore,
        *,
        address: str = "",
        host: str = LOOPBACK_HOSTS[0],
        port: int = 0,
        experimenter_port: int = 0,
        max_sessions: int | None = None,
        proxies: tuple[str, ...] = (),
        computers: Callable[[], Sequence[Computer]] | None = None,
    ) -> None:
        """Bind the ports of both servers.

        Args:
            store: the study.
            address: the public address; default: ``http://localhost`` with the public port.
            host: the address to listen on for participants.
            port: the public port; 0 selects a free port.
            experimenter_port: the port of the experimenter's server, on a loopback address.
            max_sessions: a limit of concurrent sessions, in addition to the measured capacity.
            proxies: addresses of the reverse proxies that provide TLS.
            computers: returns the computers that run sessions; default: only this computer.

        Raises:
            DesignError: if ``host.toml`` is invalid.
            ServerError: if the client is not built or a port is not available.
            ValueError: for an invalid address or stored state, or if another process hosts this study.
        """
        for page in ("participate.html", "host.html", "index.html"):
            check_client_page(page)
        self.store, self._state = store, HostState(store.folder)
        settings = read_host_settings(store.folder)
        private = store.folder / PRIVATE
        make_private_folder(private)
        with ExitStack() as failed:
            self._open = failed.enter_context(ExitStack())
            self._open.enter_context(lock_folder(private, HOST_LOCK_FILE))
            public = failed.enter_context(open_listener(host, port, behind_proxy=bool(proxies)))
            own = failed.enter_context(open_listener(LOOPBACK_HOSTS[0], experimenter_port))
            self.public_port, self.experimenter_port = int(public.getsockname()[1]), int(own.getsockname()[1])
            self.public_url = parse_public_address(address or f"http://localhost:{self.public_port}")
            failed.pop_all()
        self.pool = SessionPool(store, settings, self._state, max_sessions, computers=computers)
        self._experimenters = ExperimenterTokens(store)
        self.tokens = StudyTokens.load_for_study(private / "tokens.json", self._experimenters, SessionLinks())
        local = [f"{name}:{self.public_port}" for name in LOOPBACK_HOSTS]
        origins = frozenset({self.public_url, *(f"http://{each}" for each in local)})
        own_tokens = ParticipantTokens.load_for_study(store)
        self._participants = own_tokens.token_reader
        limiter = ConnectionLimiter(
            public, own_tokens, MAX_PARTICIPANT_CONNECTIONS, lambda scope: find_client_address(scope, proxies)
        )
        participation = ParticipantRequestContext(
            store, settings, self.pool, self._state, HeadsetCodes(), self.public_url
        )
        names = [urlsplit(self.public_url).hostname or "", *LOOPBACK_HOSTS]
        app = make_participant_app(participation, own_tokens, names, origins, proxies)
        rules = TunnelRules(
            self.pool,
            limiter,
            ("ws",),
            origins,
            frozenset({urlsplit(self.public_url).netloc, *local}),
            "participant",
        )
        self._public = WebServer(app, limiter, websockets=TunnelFactory(rules).make_protocol)
        self._experimenter = self._experimenter_server(ConnectionLimiter(own, self.tokens))

    def _experimenter_server(self, limiter: ConnectionLimiter) -> WebServer:
        app = make_experimenter_app(self.store, self.pool, self._state, self.tokens, list(LOOPBACK_HOSTS))
        hosts = frozenset(f"{name}:{self.experimenter_port}" for name in LOOPBACK_HOSTS)
        origins = frozenset(f"http://{each}" for each in hosts)
        rules = TunnelRules(self.pool, limiter, ("watch",), origins, hosts, "experimenter")
        return WebServer(app, limiter, websockets=TunnelFactory(rules).make_protocol)

    @property
    def experimenter_url(self) -> str:
        """The address of the experimenter's page."""
        return f"http://localhost:{self.experimenter_port}/#token={self.tokens.experimenter}"

    def __enter__(self) -> "StudyHost":
        self._open.enter_context(self._experimenters)
        self._open.enter_context(self._participants)
        self._open.enter_context(self.pool)
        self._open.enter_context(DeletionThread(self.store, self.pool))
        self._open.enter_context(RecordingUploader(self.store))
        for server in (self._public, self._experimenter):
            server.start()
            self._open.callback(server.stop)
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def wait(self) -> None:
        """Wait until a server stops."""
        while self._public.is_running and self._experimenter.is_running:
            self._public.wait(0.5)
