"""Report section about adverse events: events in each condition, and safety measures of the robots."""

from collections.abc import Mapping, Sequence
from typing import Any

from avrgym.analysis.page.html_elements import Markup, format_count, format_number, render_table, tag
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.analysis.study_analysis import StudyAnalysis
from avrgym.study.people.adverse_events import (
    ADVERSE_EVENT_SCALE_SOURCES,
    ADVERSE_EVENT_SEVERITIES,
    RELATEDNESS_GRADES,
    SERIOUSNESS_CRITERIA,
)

EventCondition = tuple[str | None, str | None]
"""Condition in which an event began: (robot, policy) of the trial, ``PRACTICE_CONDITION``, or
``OUTSIDE_TRIALS_CONDITION``.
"""
PRACTICE_CONDITION, OUTSIDE_TRIALS_CONDITION = ("practice", None), (None, None)
NO_EVENTS_TEXT = "No adverse events were recorded."
LOST_REPORTS_TEXT = "The database was rebuilt from the recordings: reports from before that are lost."
ROBOT_SAFETY_NOTE = (
    "Stopped attempts, interventions of the force guard and contact forces are measures of the robots. They are not "
    "adverse events, and no adverse event is derived from them."
)


def render_adverse_events_section(analysis: StudyAnalysis) -> Markup:
    """Returns the report section about the adverse events of people. Withdrawn participants are included."""
    events = find_latest_event_reports(analysis)
    shown = [_by_condition(analysis, events)] if events else []
    return tag(
        "section",
        tag("h3", "Adverse events"),
        tag("p", describe_adverse_events(analysis)),
        *shown,
        *([tag("p", ADVERSE_EVENT_SCALE_SOURCES)] if events else []),
        tag("p", ROBOT_SAFETY_NOTE),
        _safety(analysis),
    )


def find_latest_event_reports(analysis: StudyAnalysis) -> list[Mapping[str, Any]]:
    """Returns the latest report of each adverse event in the study."""
    return list({row["event"]: row for row in analysis.adverse_events}.values())


def describe_adverse_events(analysis: StudyAnalysis) -> str:
    """Returns sentences for the methods section: number of adverse events, number of affected people, and lost
    reports."""
    events = find_latest_event_reports(analysis)
    flow = next((each for each in analysis.participant_flows if not each.is_simulated), None)
    deleted = (
        f" Reports of {format_count(flow.deleted_participant_count, 'deleted participant')} were deleted with their "
        f"data."
        if flow and flow.deleted_participant_count
        else ""
    )
    lost = f" {LOST_REPORTS_TEXT}" if analysis.database_rebuilt_at else ""
    if not events:
        return f"{NO_EVENTS_TEXT}{deleted}{lost}"
    people = len({row["participant"] for row in events})
    everyone = flow.enrolled_participant_count - flow.deleted_participant_count if flow else people
    return (
        f"{format_count(len(events), 'adverse event')} in {people} of {everyone} people; "
        f"{_serious(events)} serious, {_related(events)} possibly, probably or definitely related to the study."
        f"{deleted}{lost}"
    )


def _by_condition(analysis: StudyAnalysis, events: Sequence[Mapping[str, Any]]) -> Markup:
    trials = _trials(analysis)
    body: list[tuple[object, ...]] = []
    for condition in _conditions(trials):
        own = [row for row in events if _of(row["robot"], row["policy"], row["practice"]) == condition]
        exposed = {row.participant for row in trials if _of_trial(row) == condition and row.attempts}
        severities = [sum(row["severity"] == grade for row in own) for grade in ADVERSE_EVENT_SEVERITIES]
        people = len({row["participant"] for row in own})
        numbers = "–" if condition == OUTSIDE_TRIALS_CONDITION else len(exposed)
        body.append((_named(condition), numbers, len(own), people, *severities, _serious(own), _related(own)))
    heads = (
        "Condition",
        "People exposed",
        "Events",
        "People with events",
        *map(str.capitalize, ADVERSE_EVENT_SEVERITIES),
    )
    caption = "Adverse events by condition, from their latest reports; with people who withdrew"
    return render_table(caption, (*heads, "Serious", "Related"), body, numbers=range(1, 11))


def _safety(analysis: StudyAnalysis) -> Markup:
    trials = _trials(analysis)
    stopped = [
        _of(row.robot, row.policy, row.practice)
        for row in analysis.study_data.attempts
        if row.state == "stopped" and not row.simulated
    ]
    body: list[tuple[object, ...]] = []
    for condition in _conditions(trials)[:-1]:
        own = [row for row in trials if _of_trial(row) == condition]
        guarded = [row.guard_interventions for row in own if row.guard_interventions is not None]
        forces = [row.force_peak_n for row in own if row.force_peak_n is not None]
        body.append(
            (
                _named(condition),
                sum(row.attempts for row in own),
                stopped.count(condition),
                sum(guarded) if guarded else "–",
                format_number(max(forces, default=None), digits=1, absent="–"),
            )
        )
    heads = ("Condition", "Attempts", "stopped", "Interventions of the guard", "Greatest force / N")
    return render_table(
        "Stops, force guard and contact forces by condition", heads, body, numbers=range(1, 5)
    )


def _trials(analysis: StudyAnalysis) -> list[TrialRow]:
    return [row for row in analysis.study_data.trials if not row.simulated]


def _conditions(trials: Sequence[TrialRow]) -> list[EventCondition]:
    """Returns the conditions of ``trials`` in sorted order, then ``PRACTICE_CONDITION`` (if any), then
    ``OUTSIDE_TRIALS_CONDITION``.
    """
    found = sorted({_of_trial(row) for row in trials} - {PRACTICE_CONDITION}, key=str)
    practice: list[EventCondition] = [PRACTICE_CONDITION] if any(row.practice for row in trials) else []
    return [*found, *practice, OUTSIDE_TRIALS_CONDITION]


def _of_trial(row: TrialRow) -> EventCondition:
    return _of(row.robot, row.policy, row.practice)


def _of(robot: str | None, policy: str | None, practice: bool | None) -> EventCondition:
    return PRACTICE_CONDITION if practice else (robot, policy)


def _named(condition: EventCondition) -> str:
    if condition == OUTSIDE_TRIALS_CONDITION:
        return "outside trials"
    return "practice" if condition == PRACTICE_CONDITION else " ".join(map(str, condition))


def _serious(events: Sequence[Mapping[str, Any]]) -> int:
    return sum(row["seriousness"] != SERIOUSNESS_CRITERIA[0] for row in events)


def _related(events: Sequence[Mapping[str, Any]]) -> int:
    return sum(row["relatedness"] in RELATEDNESS_GRADES[2:] for row in events)
