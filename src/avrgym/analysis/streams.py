"""Streams of other devices in the report."""

from collections.abc import Callable, Sequence
from statistics import median

from avrgym.analysis.page.elements import Markup, group_caption, number_text, table, tag
from avrgym.analysis.reading.rows import StreamRow

STREAMS_METHOD = (
    "Streams came by Lab Streaming Layer, whose measured offset between clocks was added to every sample's time. "
    "Jitter is the standard deviation of a sample's time about even spacing, within stretches without a gap. Medians "
    "are over trials; streams.csv has every trial. In a gap samples are missing. At a reset the device's clock jumped; "
    "times are corrected by when samples arrived, and all other figures are of corrected times."
)
STREAM_HEADS = (
    "Stream", "Kind", "Trials", "Samples", "Rate promised / Hz", "came / Hz", "Clock offset / ms", "its range, at most",
    "Jitter / ms", "at most", "Gaps", "Clock resets", "furthest / s",
)  # fmt: skip


def streams_section(recorded: Sequence[StreamRow], simulated: bool) -> Markup:
    """A line for each stream; nothing where none was recorded."""
    rows = [row for row in recorded if row.simulated is simulated]
    names = dict.fromkeys(row.stream for row in rows)
    if not names:
        return Markup()
    body = [_line([row for row in rows if row.stream == name]) for name in names]
    caption = group_caption("Streams of other devices", simulated)
    return tag(
        "section",
        tag("h3", "Other devices"),
        tag("p", STREAMS_METHOD),
        table(caption, STREAM_HEADS, body, numbers=range(2, len(STREAM_HEADS))),
    )


def _line(rows: Sequence[StreamRow]) -> tuple[object, ...]:
    jitters = [row.jitter_ms for row in rows if row.jitter_ms is not None]
    gaps = [row.gaps for row in rows if row.gaps is not None]
    return (
        rows[0].stream,
        rows[0].kind,
        len(rows),
        sum(row.samples for row in rows),
        number_text(rows[0].rate_hz or None, absent="any time"),
        number_text(median(row.measured_hz for row in rows)),
        _ms(median, [row.offset_ms for row in rows]),
        _ms(max, [row.offset_range_ms for row in rows]),
        _ms(median, jitters),
        _ms(max, jitters),
        sum(gaps) if gaps else "–",
        sum(row.clock_resets for row in rows),
        number_text(max((row.clock_jump_s for row in rows), key=abs) or None, absent="–", digits=3),
    )


def _ms(of: Callable[[Sequence[float]], float], values: Sequence[float]) -> str:
    return number_text(of(values), digits=3) if values else "–"
