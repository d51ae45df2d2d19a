"""Add views and commands of the dashboard and of the live page to the audit log."""

import time
from collections.abc import Callable, Generator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

from avrgym.study.storage.audit_log import (
    PERSONAL_TOKEN_METHOD,
    REJECTED_COMMAND_DETAIL,
    SHARED_TOKEN_METHOD,
    SPECTATOR_TOKEN_METHOD,
    UNNAMED_PERSON,
    AuditActor,
    add_log_entry,
)
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore
from avrgym.vr.protocol import messages
from avrgym.vr.server.authentication import AuthenticatedClient

PAGE_VIEW_TIMEOUT_S = 600.0
"""A view of a page ends after this time (in seconds) without a request. Pages send requests repeatedly."""
VIEW_RESULTS_ACTION = "view results"


def make_audit_actor(caller: AuthenticatedClient) -> AuditActor:
    """Returns the person with a token, in the format of the audit log."""
    if caller.user_name:
        return AuditActor(caller.user_name, PERSONAL_TOKEN_METHOD)
    return AuditActor(
        UNNAMED_PERSON, SPECTATOR_TOKEN_METHOD if caller.role == "spectator" else SHARED_TOKEN_METHOD
    )


@dataclass
class CommandLogEntry:
    """Log entry of a command on the dashboard.

    ``pseudonym``: pseudonym of the participant. For an enrolment, it is set after the new pseudonym is known.
    """

    pseudonym: str | None


class DashboardLog:
    """Add views and commands of the dashboard to the audit log. Thread-safe."""

    def __init__(self, store: StudyStore) -> None:
        self._store = store
        self._seen_s: dict[tuple[AuthenticatedClient, str, str | None], float] = {}

    def log_page_view(self, caller: AuthenticatedClient, name: str, pseudonym: str | None = None) -> None:
        """Add a log entry for a page that a caller views. Repeated requests of the same view add no entry.

        Raises ``StudyError`` if the entry cannot be stored.
        """
        if self._store.database.is_read_only or not self._begins(caller, name, pseudonym):
            return
        try:
            shows = name == VIEW_RESULTS_ACTION
            add_log_entry(self._store, make_audit_actor(caller), name, pseudonym, shows_results=shows)
        except StudyError:
            del self._seen_s[caller, name, pseudonym]
            raise

    @contextmanager
    def log_command(
        self, caller: AuthenticatedClient, name: str, pseudonym: str | None
    ) -> Generator["CommandLogEntry"]:
        """Context manager: add a log entry for a command, even if the command is rejected. Yields the entry."""
        at, entry = make_utc_timestamp(), CommandLogEntry(pseudonym)
        try:
            yield entry
        except Exception:
            with suppress(StudyError):  # the first error is raised
                add_log_entry(
                    self._store, make_audit_actor(caller), name, pseudonym, REJECTED_COMMAND_DETAIL, at=at
                )
            raise
        add_log_entry(self._store, make_audit_actor(caller), name, entry.pseudonym, at=at)

    def _begins(self, caller: AuthenticatedClient, name: str, pseudonym: str | None) -> bool:
        key, seen_s = (caller, name, pseudonym), time.monotonic()
        before_s, self._seen_s[key] = self._seen_s.get(key), seen_s
        return before_s is None or seen_s - before_s > PAGE_VIEW_TIMEOUT_S


class LivePageLog(DashboardLog):
    """Add commands of the live page to the audit log, in the session's storage thread.

    The entry of a command is therefore stored before the effects of the command.
    """

    def __init__(self, store: StudyStore, storing: Executor, report: Callable[[str], None]) -> None:
        """``storing``: executor of the storage thread. ``report``: function that is called with each error message."""
        super().__init__(store)
        self._storing, self._report = storing, report

    def log_message(self, caller: AuthenticatedClient, message: Any, pseudonym: str | None) -> None:
        """Add an entry for a message of an experimenter or spectator.

        ``pseudonym``: participant of the running session.
        """
        match message:
            case messages.Hello() if self._begins(caller, "watch", pseudonym):
                self._submit(caller, "watch", pseudonym, "")
            case messages.ExperimenterCommand():
                self._submit(caller, message.name, pseudonym, "")
            case messages.TorsoHeightCorrection():
                detail = f"{message.torso_height_m:g} m"
                self._submit(caller, "correct torso height", pseudonym, detail)
            case messages.ParticipantBodyChoice():
                self._submit(caller, "choose body", pseudonym, message.sex)
            case messages.VelocityCommand() if self._begins(caller, "drive", pseudonym):
                self._submit(caller, "drive", pseudonym, "")
            case _:
                pass

    def _submit(self, caller: AuthenticatedClient, name: str, pseudonym: str | None, detail: str) -> None:
        at = make_utc_timestamp()
        with suppress(RuntimeError):  # the server ends
            self._storing.submit(
                add_log_entry, self._store, make_audit_actor(caller), name, pseudonym, detail, at=at
            ).add_done_callback(self._tell)

    def _tell(self, stored: Future[None]) -> None:
        error = None if stored.cancelled() else stored.exception()
        if error is not None:
            self._report(f"an entry of the audit log cannot be stored: {error}")
