"""Adverse events of participants, graded by published scales. A follow-up never replaces earlier reports.

Severity is the grade of CTCAE (Common Terminology Criteria for Adverse Events, NCI, version 5.0, 2017). Seriousness has
the criteria of ICH E2A (1994, section II.B); it is not severity. Relatedness is the attribution that NCI's CTEP uses
with CTCAE. Outcomes follow ICH E2B(R3), E.i.7.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import msgspec

from avrgym.study.storage import hash_chain, schema
from avrgym.study.storage.database_rows import AdverseEventReport, Trial
from avrgym.study.storage.free_text import check_note, check_single_line
from avrgym.study.storage.schema import make_utc_timestamp
from avrgym.study.storage.state_transitions import StudyError
from avrgym.study.storage.store import StudyStore, find_participant, find_row, record_event

ADVERSE_EVENT_SEVERITIES = ("mild", "moderate", "severe", "life-threatening", "fatal")
SERIOUSNESS_CRITERIA = (
    "not serious",
    "other medically important",
    "congenital anomaly",
    "disability",
    "hospitalisation",
    "life-threatening",
    "death",
)
RELATEDNESS_GRADES = ("unrelated", "unlikely", "possible", "probable", "definite")
ADVERSE_EVENT_OUTCOMES = (
    "recovered",
    "recovering",
    "not recovered",
    "recovered with sequelae",
    "fatal",
    "unknown",
)
ADVERSE_EVENT_RATING_SCALES = {
    "severity": ADVERSE_EVENT_SEVERITIES,
    "seriousness": SERIOUSNESS_CRITERIA,
    "relatedness": RELATEDNESS_GRADES,
    "outcome": ADVERSE_EVENT_OUTCOMES,
}
"""Allowed values of each rating scale."""
ADVERSE_EVENT_SCALE_SOURCES = (
    "Severity: grades 1 to 5 of CTCAE 5.0 (NCI, 2017). Seriousness: criteria of ICH E2A (1994). Relatedness: "
    "attribution of NCI's CTEP. Outcome: ICH E2B(R3). Severity is the intensity of an event; seriousness depends on "
    "its consequences."
)
SAFETY_EVENT_NAMES = ("stopped", "stop rule met", "controller failed")
"""Events of a session that are listed next to adverse events, but are not adverse events."""
_CLOCKS_DIFFER = timedelta(minutes=5)


class AdverseEventDetails(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A report of an adverse event.

    ``began_at``: start of the event, ISO 8601 with UTC offset. ``trial``: position of the trial.
    ``action``: the action that was taken.
    """

    began_at: str
    description: str
    severity: str
    seriousness: str
    relatedness: str
    outcome: str
    trial: int | None = None
    action: str = ""


@dataclass(frozen=True)
class AdverseEventHistory:
    """All reports of one adverse event, in order: the first report, then its follow-ups."""

    reports: tuple[AdverseEventReport, ...]

    @property
    def event_number(self) -> int:
        """Number of the adverse event on the command line: the id of its first report."""
        return self.reports[0].id

    @property
    def latest_report(self) -> AdverseEventReport:
        """The latest report of the event: the last follow-up, or the first report."""
        return self.reports[-1]


@dataclass(frozen=True)
class SafetyEvent:
    """A safety event during a session. ``trial``: position of the trial; ``None`` between trials."""

    at: str
    trial: int | None
    name: str
    detail: str


def record_adverse_event(
    store: StudyStore,
    pseudonym: str,
    report: AdverseEventDetails,
    *,
    follows: int | None = None,
    recorded_by: str = "",
) -> int:
    """Store a report of an adverse event. Returns the report's id.

    Args:
        store: the study.
        pseudonym: the participant.
        report: the report.
        follows: for a follow-up, the number of its adverse event; ``None`` for a new event.
        recorded_by: name of the experimenter.

    Raises:
        StudyError: for an unknown grade, an invalid or future time, a trial or event of another participant, or a
            simulated participant.
    """
    _check(report)
    check_single_line("the name", recorded_by)
    with store.write_transaction() as connection:
        participant = find_participant(connection, pseudonym)
        if participant.simulated:
            raise StudyError(f"{pseudonym} is a simulated participant; allowed: a person")
        own = {"participant": participant.number}
        trial = None
        if report.trial is not None:
            trial = find_row(
                connection, Trial, f"trial {report.trial} of {pseudonym}", position=report.trial, **own
            ).id
        if follows is not None:
            first = find_row(
                connection, AdverseEventReport, f"adverse event {follows} of {pseudonym}", id=follows, **own
            )
            follows = first.follows or first.id
        row = hash_chain.insert_row(
            connection,
            schema.ADVERSE_EVENT_TABLE,
            **msgspec.structs.asdict(report) | own | {"trial": trial, "began_at": _utc(report.began_at)},
            recorded_at=make_utc_timestamp(),
            recorded_by=recorded_by or None,
            follows=follows,
        )
        name = "adverse event recorded" if follows is None else "adverse event followed up"
        record_event(connection, name, f"adverse event {follows or row}", own)
    return row


def group_reports_by_event(reports: Iterable[AdverseEventReport]) -> list[AdverseEventHistory]:
    """Returns the adverse events with their reports, in the order of their first reports."""
    events: dict[int, list[AdverseEventReport]] = {}
    for report in reports:
        events.setdefault(report.follows or report.id, []).append(report)
    return [AdverseEventHistory(tuple(own)) for own in events.values()]


def list_safety_events(store: StudyStore, pseudonym: str) -> Iterator[SafetyEvent]:
    """Yields the safety events of a participant's sessions. The experimenter decides which are adverse events."""
    number = store.read_participant(pseudonym).number
    positions = {trial.id: trial.position for trial in store.read_trials(pseudonym)}
    trials = {attempt.id: positions[attempt.trial] for attempt in store.read_attempts(pseudonym)}
    for event in store.read_events():
        if event.participant == number and event.name in SAFETY_EVENT_NAMES:
            yield SafetyEvent(event.recorded_at, trials.get(event.attempt or 0), event.name, event.detail)


def _check(report: AdverseEventDetails) -> None:
    for name, scale in ADVERSE_EVENT_RATING_SCALES.items():
        if getattr(report, name) not in scale:
            raise StudyError(f"unknown {name} {getattr(report, name)!r}; allowed: {', '.join(scale)}")
    check_note(report.description, "the description")
    check_single_line("the action", report.action)
    if datetime.fromisoformat(_utc(report.began_at)) > datetime.now(UTC) + _CLOCKS_DIFFER:
        raise StudyError(f"{report.began_at} is in the future; allowed: times in the past")


def _utc(at: str) -> str:
    try:
        moment = datetime.fromisoformat(at)
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise StudyError(
            f"{at!r} is not a time; allowed: ISO 8601 with a UTC offset, such as 2026-11-27T14:30+01:00"
        )
    return moment.astimezone(UTC).isoformat(timespec="seconds")
