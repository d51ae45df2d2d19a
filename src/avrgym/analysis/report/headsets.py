"""The checks of headsets on the page."""

from collections.abc import Sequence

from avrgym.analysis.headset_rows import HeadsetRow, headset_words
from avrgym.analysis.page import Markup, join, quantity, table, tag

HEADS = (
    "Participant", "Session", "Ready", "Headset", "Frames / s", "of", "Dropped", "Pose to picture, ms", "95 % within",
    "Jitter of head", "left hand", "right hand, mm", "Buzz", "Chime", "Stop", "after, s",
)  # fmt: skip


def headset_checks(rows: Sequence[HeadsetRow]) -> Markup:
    """What they measured; nothing where no session began with one."""
    if not rows:
        return Markup()
    shown = table("Checks of the headset", HEADS, [_cells(row) for row in rows], numbers=[*range(4, 12), 15])
    return join([tag("p", headset_words(rows)), shown])


def _cells(row: HeadsetRow) -> tuple[object, ...]:
    return (
        row.participant + (" (simulated)" if row.simulated else ""),
        row.session,
        "yes" if row.go else f"no: {row.faults}",
        ("EMULATED: " if row.emulated else "") + (row.profiles or row.device or "unknown"),
        quantity(row.frame_rate_hz, digits=0),
        quantity(row.display_hz, digits=0, absent="–"),
        f"{100.0 * row.dropped_share:.1f} %",
        quantity(row.latency_p50_ms, digits=0, absent="–"),
        quantity(row.latency_p95_ms, digits=0, absent="–"),
        quantity(row.head_jitter_mm, absent="–"),
        _hand(row.left_with, row.left_jitter_mm),
        _hand(row.right_with, row.right_jitter_mm),
        _felt(row.haptics),
        _felt(row.sound),
        "not asked" if row.stop_worked is None else row.stop_with if row.stop_worked else "not tried",
        quantity(row.stop_after_s, absent="–"),
    )


def _hand(tracked_with: str, jitter_mm: float | None) -> str:
    return f"{quantity(jitter_mm, absent='–')} ({tracked_with})"


def _felt(answer: bool | None) -> str:
    return "not asked" if answer is None else "yes" if answer else "no"
