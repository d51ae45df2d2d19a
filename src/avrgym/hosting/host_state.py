"""State of the host that remains after a restart: open or closed, waiting list, and running sessions.

The private file ``host.json`` contains the state, including the links of running sessions. Open pages of participants
therefore reconnect to their session after a crash of the host.
"""

import threading
from pathlib import Path

import msgspec

from avrgym.study.storage.identity_file import IDENTITY_FOLDER as PRIVATE
from avrgym.system.files import PRIVATE_FILE_MODE, make_private_folder, write_atomically

HOST_STATE_FILE = "host.json"


class RunningSession(msgspec.Struct, frozen=True):
    """A running session. Fields: see ``HostedSession``. ``began_at_s``: time of the start, in seconds since 1970."""

    id: str
    pseudonym: str
    link: str
    began_at_s: float
    crashes: int


class _State(msgspec.Struct, frozen=True):
    is_open: bool = True
    waiting: tuple[str, ...] = ()
    sessions: tuple[RunningSession, ...] = ()


class HostState:
    """The stored state of the host of one study. Thread-safe."""

    def __init__(self, folder: Path) -> None:
        """``folder``: the study's folder.

        Raises:
            ValueError: for a damaged file.
        """
        self._path = folder / PRIVATE / HOST_STATE_FILE
        self._lock = threading.Lock()
        try:
            data = self._path.read_bytes() if self._path.exists() else b"{}"
            self._stored = msgspec.json.decode(data, type=_State)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ValueError(
                f"{self._path} is damaged: {error}; delete the file to start without earlier sessions"
            ) from None

    @property
    def is_study_open(self) -> bool:
        """Whether the study accepts new participants and starts sessions."""
        return self._stored.is_open

    @property
    def waiting_pseudonyms(self) -> tuple[str, ...]:
        """Pseudonyms of the waiting participants, in order of arrival."""
        return self._stored.waiting

    @property
    def sessions(self) -> tuple[RunningSession, ...]:
        """The sessions that were running when the state was last stored."""
        return self._stored.sessions

    def set_study_open(self, is_open: bool) -> None:
        """Open or close the study. Raises ``OSError`` if the file cannot be written; nothing is changed then."""
        self._store(is_open=is_open)

    def store_sessions(self, waiting: tuple[str, ...], sessions: tuple[RunningSession, ...]) -> None:
        """Store the waiting list and the running sessions. Raises ``OSError`` if they cannot be stored."""
        self._store(waiting=waiting, sessions=sessions)

    def _store(self, **changes: object) -> None:
        with self._lock:
            state = msgspec.structs.replace(self._stored, **changes)
            if state != self._stored:
                make_private_folder(self._path.parent)
                write_atomically(self._path, msgspec.json.encode(state), PRIVATE_FILE_MODE)
                self._stored = state
