"""How late pictures were for one group of participants, on the page."""

from avrgym.analysis.page import Markup, table, tag
from avrgym.analysis.report.results import captioned
from avrgym.analysis.study import Analysis
from avrgym.vr.latency import STAGE_WORDS, TOTAL

METHOD = (
    "Latency: for every tracking frame the client reports when its pose was read and sent, when the state that follows "
    "it came and when a picture showed it; the server reports when the frame came, when it was simulated and when that "
    "state was sent. The clocks are aligned by the fastest messages of ten seconds. Percentiles are over the frames of "
    "counted trials. A headset's display adds its own time; own arms are drawn without waiting for all this."
)


def latency(analysis: Analysis, simulated: bool) -> Markup:
    """Stage by stage, and who saw the latest pictures; nothing where no recording tells."""
    rows = [row for row in analysis.latency if row.simulated is simulated]
    if not rows:
        return Markup()
    together = [row for row in rows if row.participant is None]
    words = {TOTAL: "from pose to picture", **STAGE_WORDS}
    body = [
        (words[row.stage], *(f"{ms:.1f}" for ms in (row.p50_ms, row.p95_ms, row.p99_ms))) for row in together
    ]
    own = [row for row in rows if row.participant is not None and row.stage == TOTAL]
    latest = max(own, key=lambda row: row.p95_ms)
    heads = ("Stage", "Median / ms", "95 % within / ms", "99 % within / ms")
    caption = captioned(f"How late pictures were: {together[0].pictures} frames", simulated)
    note = f"The latest pictures had {latest.participant}: 95 % within {latest.p95_ms:.1f} ms."
    return tag(
        "section", tag("h3", "Latency"), table(caption, heads, body, numbers=range(1, 4)), tag("p", note)
    )
