"""Sessions of participants: day, completed trials, time in VR and breaks of each session."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from avrgym.analysis.column_types import AT_LEAST_0_TEXT, SessionNumber
from avrgym.analysis.page.html_elements import Markup, format_group_caption, render_table, tag
from avrgym.analysis.reading.table_rows import ParticipantColumns, ParticipantRow
from avrgym.study.storage.session_summary import summarise_sessions
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column


@dataclass(frozen=True, kw_only=True)
class SessionRow(ParticipantColumns):
    """A session of a participant: its day, number of completed trials, time in VR and breaks."""

    session: SessionNumber
    day: Annotated[
        int, Column("Day of the session. Day 1 is the day of the first session, in UTC.", allowed="from 1")
    ]
    trials: Annotated[int, Column("Number of completed trials.", allowed=AT_LEAST_0_TEXT)]
    minutes: Annotated[float, Column("Time in VR.", unit="min", allowed=AT_LEAST_0_TEXT)]
    breaks: Annotated[int, Column("Number of breaks.", allowed=AT_LEAST_0_TEXT)]
    state: Annotated[str, Column("State of the session.")]


def make_session_rows(store: StudyStore, participants: Sequence[ParticipantRow]) -> list[SessionRow]:
    """Returns a row for each session of the participants, in order."""
    rows: list[SessionRow] = []
    for participant in participants:
        own = summarise_sessions(store, participant.participant)
        days = [datetime.fromisoformat(each.opened_at).date() for each in own]
        rows += [
            SessionRow(
                participant=participant.participant,
                site=participant.site,
                simulated=participant.simulated,
                session=each.number,
                day=1 + (day - days[0]).days,
                trials=each.trials,
                minutes=each.minutes,
                breaks=each.breaks,
                state=each.state,
            )
            for each, day in zip(own, days, strict=True)
        ]
    return rows


def render_sessions_section(rows: Sequence[SessionRow], simulated: bool) -> Markup:
    """Returns the report section; empty if no participant had several sessions or a break."""
    own = [row for row in rows if row.simulated is simulated]
    if not any(row.session > 1 or row.breaks for row in own):
        return Markup()
    body = [
        (row.participant, row.session, row.day, row.trials, f"{row.minutes:.1f}", row.breaks, row.state)
        for row in own
    ]
    heads = ("Participant", "Session", "Day", "Trials completed", "In VR / min", "Breaks", "State")
    caption = "Sessions; day 1 is the day of the participant's first session"
    return tag(
        "section",
        tag("h3", "Sessions"),
        render_table(format_group_caption(caption, simulated), heads, body, numbers=range(1, 6)),
    )
