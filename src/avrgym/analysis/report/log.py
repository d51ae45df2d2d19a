"""The log on a study's page: the number of entries, the people in it, and early views of results."""

from avrgym.analysis.page import Markup, count, listing, tag
from avrgym.analysis.reading.study_log import StudyLog


def log_section(log: StudyLog) -> Markup:
    """The log by count, and views of results before the planned end."""
    return tag("section", tag("h2", "The log"), tag("p", *_words(log)), *_looks(log), id="log")


def _words(log: StudyLog) -> tuple[Markup | str, ...]:
    if not log.entries:
        return ("The log has no entry: no command and no view of this study was logged.",)
    entries = "1 entry" if log.entries == 1 else f"{log.entries} entries"
    return (
        f"The log has {entries}, from {log.first_at} to {log.last_at} (UTC), by {', '.join(log.people)}. Views of "
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
