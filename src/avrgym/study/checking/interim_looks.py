"""Find interim looks (early views of results) in a study's log.

A view is early if not all planned participants have completed the study."""

from collections import defaultdict
from collections.abc import Iterator

from avrgym.study.checking.finding import Finding
from avrgym.study.storage.audit_log import describe_log_person, read_site_names
from avrgym.study.storage.database_rows import AuditLogEntry
from avrgym.study.storage.store import StudyStore

RESULTS_LOCATION = "results"
"""The value of ``Finding.where`` for interim looks."""


def check_interim_looks(store: StudyStore, planned: int = 0) -> Iterator[Finding]:
    """Yields findings about interim looks: views of results before all planned participants completed the study.

    One finding contains all views of one person at the same number of completed participants. The planned number of
    participants is the maximum of ``planned`` and the design's number at the time of the view.
    """
    sites = read_site_names(store)
    looks = defaultdict[tuple[str, int, int], list[AuditLogEntry]](list)
    for entry in store.read_audit_log():
        if is_interim_look(entry, planned):
            most = max(planned, entry.planned or 0)
            looks[describe_log_person(entry, sites), entry.completed or 0, most].append(entry)
    for (who, completed, most), entries in looks.items():
        times = f" {len(entries)} times" if len(entries) > 1 else ""
        first = ", first" if len(entries) > 1 else ""
        names = ", ".join(dict.fromkeys(entry.action for entry in entries))
        message = (
            f"were viewed{times} after {completed} of {most} participants by {who}{first} at "
            f"{entries[0].recorded_at} (UTC): {names}"
        )
        yield Finding(RESULTS_LOCATION, message, is_error=False)


def is_interim_look(entry: AuditLogEntry, planned: int = 0) -> bool:
    """Returns whether the log entry is a view of results before all planned participants completed the study."""
    if entry.completed is None or entry.planned is None:
        return False
    return entry.completed < max(planned, entry.planned)
