"""The log on a study's page: the number of entries, the people in it, and early views of results."""

from avrgym.analysis.page import Markup, count, listing, tag
from avrgym.analysis.reading.study_log import StudyLog

LOST = "The database was rebuilt from the recordings: entries from before that are lost."


def log_section(log: StudyLog, rebuilt_at: str | None) -> Markup:
    """The log by count, and views of results before the planned end; ``rebuilt_at`` is of a rebuilt database."""
    lost = [tag("p", LOST)] if rebuilt_at else []
    return tag(
        "section", tag("h2", "The log"), tag("p", *_words(log, rebuilt_at)), *lost, *_looks(log), id="log"
    )


def _words(log: StudyLog, rebuilt_at: str | None) -> tuple[Markup | str, ...]:
    if not log.entries and rebuilt_at:
        return ("The log has no entry.",)
    if not log.entries:
        return ("The log has no entry: no command and no view of this study was logged.",)
    entries = "1 entry" if log.entries == 1 else f"{log.entries} entries"
    time = f"at {log.first_at}" if log.entries == 1 else f"from {log.first_at} to {log.last_at}"
    return (
        f"The log has {entries}, {time} (UTC), by {', '.join(log.people)}. Views of "
        "results after the planned end are not counted. The whole log: ",
        tag("code", "avrgym study export --format csv"),
        ".",
    )


def _looks(log: StudyLog) -> list[Markup]:
    if not log.interim_looks:
        return [
            tag(
                "p", "The log has no view of results before the planned number of participants had completed."
            )
        ]
    found = count(len(log.interim_looks), "line")
    return [
        tag("p", f"Results were viewed before the planned number of participants had completed ({found}):"),
        listing([f"{look}." for look in log.interim_looks]),
    ]
