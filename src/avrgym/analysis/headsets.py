"""Headset checks at the start of sessions: table rows, description and report section."""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Annotated

from avrgym.analysis.column_types import (
    AT_LEAST_0_TEXT,
    FRACTION_RANGE_TEXT,
    IsSimulated,
    Pseudonym,
    SessionNumber,
)
from avrgym.analysis.page.html_elements import (
    Markup,
    format_count,
    format_number,
    join_markup,
    render_table,
    tag,
)
from avrgym.recording.configuration import HeadsetCheck
from avrgym.study.storage.database_rows import Participant, StudySession
from avrgym.study.storage.store import StudyStore
from avrgym.system.columns import Column
from avrgym.vr.headset_check import format_faults, is_headset_ready

_NOT_MEASURED, _NOT_ASKED = "not measured", "not asked"
TrackingJitter = Annotated[float | None, Column("Tracking jitter at rest.", unit="mm", empty=_NOT_MEASURED)]
TrackingReach = Annotated[
    float | None, Column("Largest distance from the head.", unit="m", empty=_NOT_MEASURED)
]
TrackedInputDevice = Annotated[str, Column("Tracked as controller, hand or mouse.", empty="not tracked")]


@dataclass(frozen=True, kw_only=True)
class HeadsetCheckRow:
    """Measurements and findings of the latest headset check of a session."""

    participant: Pseudonym
    simulated: IsSimulated
    session: SessionNumber
    device: Annotated[str, Column("The device, as the browser reports it.", empty="unknown")]
    emulated: Annotated[bool, Column("Whether the headset was emulated.")]
    profiles: Annotated[
        str, Column("Profiles of the controllers, as the browser reports them.", empty="none")
    ]
    display_hz: Annotated[
        float | None, Column("Refresh rate of the display.", unit="Hz", empty=_NOT_MEASURED)
    ]
    frame_rate_hz: Annotated[float, Column("Measured frame rate.", unit="Hz", allowed=AT_LEAST_0_TEXT)]
    dropped_share: Annotated[float, Column("Share of dropped frames.", allowed=FRACTION_RANGE_TEXT)]
    latency_p50_ms: Annotated[
        float | None,
        Column("Median latency from tracked pose to displayed frame.", unit="ms", empty=_NOT_MEASURED),
    ]
    latency_p95_ms: Annotated[
        float | None, Column("95th percentile of that latency.", unit="ms", empty=_NOT_MEASURED)
    ]
    head_jitter_mm: TrackingJitter
    left_with: TrackedInputDevice
    left_jitter_mm: TrackingJitter
    left_reach_m: TrackingReach
    right_with: TrackedInputDevice
    right_jitter_mm: TrackingJitter
    right_reach_m: TrackingReach
    haptics: Annotated[bool | None, Column("Whether the participant felt the vibration.", empty=_NOT_ASKED)]
    sound: Annotated[bool | None, Column("Whether the participant heard the sound.", empty=_NOT_ASKED)]
    stop_with: Annotated[
        str, Column("How the participant stopped the robot in the check.", empty="not requested, or not done")
    ]
    stop_worked: Annotated[
        bool | None, Column("Whether the participant stopped the robot in time.", empty="not requested")
    ]
    stop_after_s: Annotated[
        float | None,
        Column("Time from the request to the stop.", unit="s", empty="not requested, or not done"),
    ]
    go: Annotated[bool, Column("Whether the headset was ready.")]
    faults: Annotated[str, Column("Faults that the check found.", empty="none")]


def make_headset_check_rows(store: StudyStore) -> list[HeadsetCheckRow]:
    """Returns a row for the headset check of each session, in order. Sessions without a check are omitted."""
    return [
        _row(participant, session, session.latest_headset_check)
        for participant in store.read_participants()
        for session in store.read_sessions(participant.pseudonym)
        if session.latest_headset_check is not None
    ]


def _row(participant: Participant, session: StudySession, check: HeadsetCheck) -> HeadsetCheckRow:
    total = check.latency_ms.get("total_ms", {})
    stopped = check.stop_method not in (None, "none")
    return HeadsetCheckRow(
        participant=participant.pseudonym,
        simulated=participant.simulated,
        session=session.number,
        device=check.device,
        emulated=check.emulated,
        profiles=" ".join(check.profiles),
        display_hz=check.display_hz,
        frame_rate_hz=check.frame_rate_hz,
        dropped_share=check.dropped_share,
        latency_p50_ms=total.get("p50"),
        latency_p95_ms=total.get("p95"),
        head_jitter_mm=check.head.jitter_mm,
        left_with=check.left.modality,
        left_jitter_mm=check.left.jitter_mm,
        left_reach_m=check.left.reach_m,
        right_with=check.right.modality,
        right_jitter_mm=check.right.jitter_mm,
        right_reach_m=check.right.reach_m,
        haptics=check.vibration_felt,
        sound=check.sound_heard,
        stop_with=check.stop_method or "" if stopped else "",
        stop_worked=None if check.stop_method is None else stopped,
        stop_after_s=check.stop_delay_s,
        go=is_headset_ready(check),
        faults=format_faults(check),
    )


def describe_headset_checks(rows: Sequence[HeadsetCheckRow]) -> str:
    """Returns a summary of the checks for the methods section of a publication; empty without checks."""
    if not rows:
        return ""
    ready, emulated = sum(row.go for row in rows), sum(row.emulated for row in rows)
    latencies = [row.latency_p50_ms for row in rows if row.latency_p50_ms is not None]
    jitters = [row.head_jitter_mm for row in rows if row.head_jitter_mm is not None]
    held = sorted({name for row in rows for name in (row.left_with, row.right_with)})
    figures = [
        f"{median(row.frame_rate_hz for row in rows):.0f} frames a second",
        f"{100.0 * median(row.dropped_share for row in rows):.1f} % of frames dropped",
        *([f"{median(latencies):.0f} ms from pose to frame"] if latencies else []),
        *([f"{median(jitters):.2f} mm of jitter of the head at rest"] if jitters else []),
    ]
    made_up = (
        f" {format_count(emulated, 'check')} ran on an emulated headset, which gives no information about a real one."
        * bool(emulated)
    )
    return (
        f"The headset was checked at the beginning of {format_count(len(rows), 'session')} and found ready in {ready} "
        f"(medians: {', '.join(figures)}; hands tracked with: {', '.join(held)}).{made_up}"
    )


HEADSET_TABLE_HEADINGS = (
    "Participant", "Session", "Ready", "Headset", "Frames / s", "of", "Dropped", "Pose to frame, ms", "95 % within",
    "Jitter of head", "left hand", "right hand, mm", "Buzz", "Chime", "Stop", "after, s",
)  # fmt: skip


def render_headset_section(rows: Sequence[HeadsetCheckRow]) -> Markup:
    """Returns the report section: a summary and a table of the headset checks; empty without checks."""
    if not rows:
        return Markup()
    shown = render_table(
        "Checks of the headset",
        HEADSET_TABLE_HEADINGS,
        [_cells(row) for row in rows],
        numbers=[*range(4, 12), 15],
    )
    return join_markup([tag("p", describe_headset_checks(rows)), shown])


def _cells(row: HeadsetCheckRow) -> tuple[object, ...]:
    return (
        row.participant + (" (simulated)" if row.simulated else ""),
        row.session,
        "yes" if row.go else f"no: {row.faults}",
        ("EMULATED: " if row.emulated else "") + (row.profiles or row.device or "unknown"),
        format_number(row.frame_rate_hz, digits=0),
        format_number(row.display_hz, digits=0, absent="–"),
        f"{100.0 * row.dropped_share:.1f} %",
        format_number(row.latency_p50_ms, digits=0, absent="–"),
        format_number(row.latency_p95_ms, digits=0, absent="–"),
        format_number(row.head_jitter_mm, absent="–"),
        _hand(row.left_with, row.left_jitter_mm),
        _hand(row.right_with, row.right_jitter_mm),
        _felt(row.haptics),
        _felt(row.sound),
        "not asked" if row.stop_worked is None else row.stop_with if row.stop_worked else "not tried",
        format_number(row.stop_after_s, absent="–"),
    )


def _hand(tracked_with: str, jitter_mm: float | None) -> str:
    return f"{format_number(jitter_mm, absent='–')} ({tracked_with})"


def _felt(answer: bool | None) -> str:
    return "not asked" if answer is None else "yes" if answer else "no"
