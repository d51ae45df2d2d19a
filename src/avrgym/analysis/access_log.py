"""Access log of a study: number of entries, users, and interim looks at results."""

from collections.abc import Sequence
from dataclasses import dataclass

from avrgym.analysis.page.html_elements import Markup, format_count, format_timestamp, render_bullet_list, tag
from avrgym.study.checking.interim_looks import check_interim_looks, is_interim_look
from avrgym.study.storage.audit_log import describe_log_person, read_site_names
from avrgym.study.storage.store import StudyStore


@dataclass(frozen=True)
class AccessLogSummary:
    """Summary of the access log of a study.

    ``entries``: number of entries. ``people``: users in the log. ``first_at``, ``last_at``: times of the first and last
    entry (ISO 8601). ``interim_looks``: description of each view of results before the planned number of participants
    completed the study.
    """

    entries: int
    people: Sequence[str]
    first_at: str | None
    last_at: str | None
    interim_looks: Sequence[str]


def summarise_access_log(store: StudyStore) -> AccessLogSummary:
    """Returns a summary of the access log. Entries for views of results after the planned end are ignored."""
    sites = read_site_names(store)
    own = [entry for entry in store.read_audit_log() if entry.completed is None or is_interim_look(entry)]
    return AccessLogSummary(
        entries=len(own),
        people=list(dict.fromkeys(describe_log_person(entry, sites) for entry in own)),
        first_at=min((entry.recorded_at for entry in own), default=None),
        last_at=max((entry.recorded_at for entry in own), default=None),
        interim_looks=[f"{each.where} {each.message}" for each in check_interim_looks(store)],
    )


LOST_ENTRIES_TEXT = "The database was rebuilt from the recordings: entries from before that are lost."


def render_access_log_section(log: AccessLogSummary, rebuilt_at: str | None) -> Markup:
    """Returns the report section about the access log.

    ``rebuilt_at``: time of the rebuild of the database (ISO 8601); ``None`` if it was not rebuilt.
    """
    lost = [tag("p", LOST_ENTRIES_TEXT)] if rebuilt_at else []
    return tag(
        "section",
        tag("h2", "The log"),
        tag("p", *_summary_text(log, rebuilt_at)),
        *lost,
        *_interim_looks(log),
        id="log",
    )


def _summary_text(log: AccessLogSummary, rebuilt_at: str | None) -> tuple[Markup | str, ...]:
    if not log.entries and rebuilt_at:
        return ("The log has no entry.",)
    if not log.entries:
        return ("The log has no entry: no command and no view of this study was logged.",)
    entries = "1 entry" if log.entries == 1 else f"{log.entries} entries"
    time = (
        f"at {format_timestamp(log.first_at)}"
        if log.entries == 1
        else f"from {format_timestamp(log.first_at)} to {format_timestamp(log.last_at)}"
    )
    return (
        f"The log has {entries}, {time} (UTC), by {', '.join(log.people)}. Views of "
        "results after the planned end are not included. The complete log: ",
        tag("code", "avrgym study export --format csv"),
        ".",
    )


def _interim_looks(log: AccessLogSummary) -> list[Markup]:
    if not log.interim_looks:
        return [
            tag(
                "p", "The log has no view of results before the planned number of participants had completed."
            )
        ]
    found = format_count(len(log.interim_looks), "line")
    return [
        tag("p", f"Results were viewed before the planned number of participants had completed ({found}):"),
        render_bullet_list([f"{look}." for look in log.interim_looks]),
    ]
