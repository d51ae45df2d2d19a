"""Entries of commands in the study's log, under the user account that runs them."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from avrgym.cli.terminal import warn

if TYPE_CHECKING:
    from avrgym.study.storage.store import Store


def log(
    store: "Store",
    name: str,
    participant: str | None = None,
    detail: str = "",
    *,
    shows_results: bool = False,
) -> None:
    """Add an entry for a command; print a warning if the study can only be read."""
    from avrgym.study.storage.audit_log import account_actor, add_entry

    if store.database.read_only:
        warn(f"{store.folder} cannot be written: its log does not contain this command")
    else:
        add_entry(store, account_actor(), name, participant, detail, shows_results=shows_results)


@contextmanager
def logged(store: "Store", begins: str, ends: str) -> Generator[None]:
    """Add an entry at the start of a long command, and one at its end."""
    from avrgym.study.storage.states import StudyError

    log(store, begins)
    try:
        yield
    finally:
        with suppress(StudyError):  # a busy database keeps no program from ending
            log(store, ends)
