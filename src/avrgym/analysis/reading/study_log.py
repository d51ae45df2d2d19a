"""The number of entries in the log of a study, and views of results before its planned end."""

from collections.abc import Sequence
from dataclasses import dataclass

from avrgym.study.checking.interim_looks import check_interim_looks, is_interim
from avrgym.study.storage.audit_log import describe_person, site_names
from avrgym.study.storage.store import Store


@dataclass(frozen=True)
class StudyLog:
    """Entries of a log by count, with the times of the first and the last, and the people in it, in words.

    Views of results after the planned end do not count. ``interim_looks`` are those before it, in words.
    """

    entries: int
    people: Sequence[str]
    first_at: str | None
    last_at: str | None
    interim_looks: Sequence[str]


def study_log(store: Store) -> StudyLog:
    """The log of a study as it is now."""
    sites = site_names(store)
    own = [entry for entry in store.log() if entry.completed is None or is_interim(entry)]
    return StudyLog(
        entries=len(own),
        people=list(dict.fromkeys(describe_person(entry, sites) for entry in own)),
        first_at=min((entry.at for entry in own), default=None),
        last_at=max((entry.at for entry in own), default=None),
        interim_looks=[f"{each.where} {each.what}" for each in check_interim_looks(store)],
    )
