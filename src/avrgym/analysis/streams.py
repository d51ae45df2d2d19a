"""Report section about the recorded Lab Streaming Layer streams of other devices."""

from collections.abc import Callable, Sequence
from statistics import median

from avrgym.analysis.page.elements import Markup, group_caption, number_text, table, tag
from avrgym.analysis.reading.rows import StreamRow

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


def streams_section(recorded: Sequence[StreamRow], simulated: bool) -> Markup:
    """Returns the report section: a table with a row for each stream. Empty without streams."""
    rows = [row for row in recorded if row.simulated is simulated]
    names = dict.fromkeys(row.stream for row in rows)
    if not names:
        return Markup()
    body = [_line([row for row in rows if row.stream == name]) for name in names]
    caption = group_caption("Streams of other devices", simulated)
    return tag(
        "section",
        tag("h3", "Other devices"),
        tag("p", STREAMS_METHOD_TEXT),
        table(caption, STREAM_TABLE_HEADINGS, body, numbers=range(2, len(STREAM_TABLE_HEADINGS))),
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
