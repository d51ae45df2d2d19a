"""The origin of a study's frozen plan: what proves that it was made before the first participant.

The database proves it if it contains the plan's checksum from then, and was not rebuilt. A trusted time stamp from
before all recordings proves it too. Without either all results are exploratory.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime

import msgspec

from avrgym.recording.reader import RecordingError, read_beginning
from avrgym.study.plan.evidence import (
    Registration,
    TimeStamp,
    read_registration,
    read_time_stamp,
)
from avrgym.study.plan.freezing import ADOPTED, EVENT, FROZEN, Record, sha256
from avrgym.study.storage.rows import RECORDINGS, Site, StudyEvent
from avrgym.study.storage.states import StudyError
from avrgym.study.storage.store import Store, find_all

UNKNOWN = "an unknown time"
UNKNOWN_ORIGIN = (
    "is of unknown origin and confirms nothing: its checksum is not in the database; put back a copy of the database, "
    "or add a time stamp from before the first participant with `avrgym study freeze DIR --timestamp FILE`"
)


@dataclass(frozen=True)
class Frozen:
    """A frozen plan. Without a ``record`` nothing states what was planned; ``faults`` are what is wrong.

    ``known_since`` is when the database stored its checksum, before the first participant; nothing where that is
    unknown. ``is_adopted``: another station froze it. ``rebuilt_at`` is when the database was rebuilt, if it was.
    ``is_proven``: a trusted time stamp is older than all recordings.
    """

    record: Record | None
    faults: tuple[str, ...] = ()
    known_since: str | None = None
    is_adopted: bool = False
    rebuilt_at: str | None = None
    stamp: TimeStamp | None = None
    is_proven: bool = False
    registration: Registration | None = None
    sha256: str = ""

    @property
    def confirms(self) -> bool:
        """Whether it is known that the plan was made before the first participant."""
        return self.record is not None and (self.known_since is not None or self.is_proven)

    @property
    def at(self) -> str:
        """When it was frozen, as far as that is known."""
        if self.record is not None and self.known_since is not None:
            return self.known_since if self.is_adopted else self.record.frozen_at
        if self.stamp is not None and self.is_proven:
            return self.stamp.at.isoformat()
        return UNKNOWN

    @property
    def words(self) -> str:
        """What is known of its date, and what is only claimed."""
        return " ".join(self._sentences())

    def _sentences(self) -> Iterator[str]:
        if self.known_since is not None:
            verb = "was stored in the database" if self.is_adopted else "was frozen"
            yield f"The plan {verb} at {self.at} (UTC), before the first participant."
        elif self.is_proven:
            yield f"The plan existed at {self.at}, before the first recording."
        else:
            why = f", which was rebuilt at {self.rebuilt_at} (UTC)" if self.rebuilt_at else ""
            yield (
                f"When the plan was made is unknown: its checksum is not in the database{why}. "
                "It confirms nothing; all results are exploratory."
            )
        if self.stamp is not None:
            known = "knows" if self.stamp.is_trusted else "does not know"
            proves = "" if self.stamp.is_trusted else ", so the time stamp alone proves nothing"
            yield (
                f"A valid time stamp (RFC 3161) of {self.stamp.authority} gives {self.stamp.at.isoformat()}; this "
                f"computer {known} the root certificate of that authority{proves}."
            )
        if self.registration is not None:
            claim = self.registration
            yield f"The researchers claim a registration of {claim.on} at {claim.url}; this is not verified."


def read_frozen(store: Store) -> Frozen | None:
    """The study's frozen plan; ``None`` where none was frozen."""
    path = store.folder / FROZEN
    with store.database.read() as connection:
        noted = [each for name in (EVENT, ADOPTED) for each in find_all(connection, StudyEvent, name=name)]
        sites = len(find_all(connection, Site))
    if not path.exists():
        fault = "is missing; put a copy back"
        return Frozen(None, (fault,)) if noted else None
    data = path.read_bytes()
    own = [each for each in noted if each.detail == sha256(data)]
    if noted and not own:
        fault = "was modified after freezing; put a copy back"
        return Frozen(None, (fault,))
    try:
        record = msgspec.json.decode(data, type=Record)
    except ValueError as error:
        return Frozen(None, (f"is damaged: {error}",))
    rebuilt_at = store.rebuilt_at()
    is_known = len(own) >= max(sites, 1) and rebuilt_at is None
    return _with_evidence(
        store,
        data,
        Frozen(
            record,
            known_since=max(each.at for each in own) if is_known else None,
            is_adopted=all(each.name == ADOPTED for each in own),
            rebuilt_at=rebuilt_at,
            sha256=sha256(data),
        ),
    )


def _with_evidence(store: Store, data: bytes, frozen: Frozen) -> Frozen:
    """A frozen plan with the evidence from outside, and with what is wrong."""
    faults: list[str] = []
    stamp, registration = None, None
    try:
        stamp = read_time_stamp(store.folder, data)
    except StudyError as error:
        faults.append(f"has a time stamp that proves nothing: {error}")
    try:
        registration = read_registration(store.folder)
    except StudyError as error:
        faults.append(str(error))
    is_proven = stamp is not None and stamp.is_trusted and _is_before_all(store, stamp.at)
    result = replace(frozen, stamp=stamp, registration=registration, is_proven=is_proven)
    if not result.confirms:
        faults.insert(0, UNKNOWN_ORIGIN)
    return replace(result, faults=tuple(faults))


def _is_before_all(store: Store, moment: datetime) -> bool:
    """Whether a moment is before the beginning of every recording; one of unknown beginning proves nothing."""
    try:
        beginnings = [read_beginning(path) for path in (store.folder / RECORDINGS).rglob("*.mcap")]
    except (OSError, RecordingError):
        return False
    return all(each is not None and moment < each for each in beginnings)
