"""Report section about the recorded Lab Streaming Layer streams of other devices."""

from collections.abc import Callable, Sequence
from statistics import median

from avrgym.analysis.page.html_elements import Markup, format_group_caption, format_number, render_table, tag
from avrgym.analysis.reading.table_rows import StreamRow

STREAMS_METHOD_TEXT = (
    "Lab Streaming Layer transmits the streams. The measured clock offset is added to the time of each sample. Jitter "
    "is the standard deviation of sample times about even spacing, between gaps. Gaps are stretches with missing "
    "samples. Medians are over trials; streams.csv contains every trial. At a clock reset, the device's clock jumped; "
    "times are corrected by the arrival of samples, and all metrics use corrected times."
)
STREAM_TABLE_HEADINGS = (
    "Stream", "Kind", "Trials", "Samples", "Nominal rate / Hz", "Measured / Hz", "Clock offset / ms", "Maximum range",
    "Jitter / ms", "Maximum", "Gaps", "Clock resets", "Largest / s",
)  # fmt: skip


def render_streams_section(recorded: Sequence[StreamRow], simulated: bool) -> Markup:
    """Returns the report section: a table with a row for each stream. Empty without streams."""
    rows = [row for row in recorded if row.simulated is simulated]
    names = dict.fromkeys(row.stream for row in rows)
    if not names:
        return Markup()
    body = [_line([row for row in rows if row.stream == name]) for name in names]
    caption = format_group_caption("Streams of other devices", simulated)
    return tag(
        "section",
        tag("h3", "Other devices"),
        tag("p", STREAMS_METHOD_TEXT),
        render_table(caption, STREAM_TABLE_HEADINGS, body, numbers=range(2, len(STREAM_TABLE_HEADINGS))),
    )


def _line(rows: Sequence[StreamRow]) -> tuple[object, ...]:
    jitters = [row.jitter_ms for row in rows if row.jitter_ms is not None]
    gaps = [row.gaps for row in rows if row.gaps is not None]
    return (
        rows[0].stream,
        rows[0].kind,
        len(rows),
        sum(row.samples for row in rows),
        format_number(rows[0].rate_hz or None, absent="any time"),
        format_number(median(row.measured_hz for row in rows)),
        _ms(median, [row.offset_ms for row in rows]),
        _ms(max, [row.offset_range_ms for row in rows]),
        _ms(median, jitters),
        _ms(max, jitters),
        sum(gaps) if gaps else "–",
        sum(row.clock_resets for row in rows),
        format_number(max((row.clock_jump_s for row in rows), key=abs) or None, absent="–", digits=3),
    )


def _ms(of: Callable[[Sequence[float]], float], values: Sequence[float]) -> str:
    return format_number(of(values), digits=3) if values else "–"
