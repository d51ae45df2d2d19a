"""Add an entry for each command, with the user account, to the audit log of the study."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from avrgym.cli.terminal import print_warning

if TYPE_CHECKING:
    from avrgym.study.storage.store import StudyStore


def log_command(
    store: "StudyStore",
    name: str,
    participant: str | None = None,
    detail: str = "",
    *,
    shows_results: bool = False,
) -> None:
    """Add an entry for the command ``name`` to the audit log. If the study is read-only, print a warning instead."""
    from avrgym.study.storage.audit_log import add_log_entry, find_process_user

    if store.database.is_read_only:
        print_warning(f"{store.folder} is read-only: its audit log does not contain this command")
    else:
        add_log_entry(store, find_process_user(), name, participant, detail, shows_results=shows_results)


@contextmanager
def log_start_and_end(store: "StudyStore", begins: str, ends: str) -> Generator[None]:
    """Context manager: add the entry ``begins`` at the start of a long command, and ``ends`` at its end."""
    from avrgym.study.storage.state_transitions import StudyError

    log_command(store, begins)
    try:
        yield
    finally:
        with suppress(StudyError):  # a busy database must not prevent the end of the program
            log_command(store, ends)
