"""Latency from a tracked pose to the displayed frame: table rows and report section."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

from avrgym.analysis.column_types import AT_LEAST_0_TEXT, IsSimulated
from avrgym.analysis.page.html_elements import Markup, format_group_caption, render_table, tag
from avrgym.analysis.reading.table_rows import TrialRow
from avrgym.recording.schema import Latency
from avrgym.system.columns import Column
from avrgym.vr.latency import STAGE_LABELS, TOTAL_LATENCY_KEY, compute_percentiles_ms

LatenciesByTrial = Mapping[tuple[str, int], Sequence[Latency]]
"""Latency measurements of each trial, by (pseudonym, position of the trial)."""


@dataclass(frozen=True, kw_only=True)
class LatencyRow:
    """Duration of one latency stage between tracked pose and displayed frame, in analysed trials."""

    participant: Annotated[
        str | None, Column("Pseudonym.", empty="all people, or all simulated participants, together")
    ]
    simulated: IsSimulated
    stage: Annotated[str, Column("Stage from pose to frame; total_ms is the total latency.")]
    pictures: Annotated[
        int, Column("Number of tracking frames that were displayed.", allowed=AT_LEAST_0_TEXT)
    ]
    p50_ms: Annotated[float, Column("Median duration.", unit="ms", allowed=AT_LEAST_0_TEXT)]
    p95_ms: Annotated[float, Column("95th percentile of the duration.", unit="ms", allowed=AT_LEAST_0_TEXT)]
    p99_ms: Annotated[float, Column("99th percentile of the duration.", unit="ms", allowed=AT_LEAST_0_TEXT)]


def make_latency_rows(trials: Sequence[TrialRow], latencies: LatenciesByTrial) -> list[LatencyRow]:
    """Returns latency rows: all people together, then each person; then the same for simulated participants.

    Only analysed trials with latency measurements are used.
    """
    rows: list[LatencyRow] = []
    for simulated in (False, True):
        told = {
            (row.participant, row.position): latencies[row.participant, row.position]
            for row in trials
            if row.counted and row.simulated is simulated and (row.participant, row.position) in latencies
        }
        rows.extend(_rows(None, [each for those in told.values() for each in those], simulated=simulated))
        for participant in dict.fromkeys(pseudonym for pseudonym, _ in told):
            own = [
                each for (pseudonym, _), those in told.items() if pseudonym == participant for each in those
            ]
            rows.extend(_rows(participant, own, simulated=simulated))
    return rows


def _rows(participant: str | None, told: Sequence[Latency], *, simulated: bool) -> Iterator[LatencyRow]:
    pictures = sum(len(each.sequence) for each in told)
    for stage, shares in compute_percentiles_ms(told).items():
        percentiles = {f"{share}_ms": ms for share, ms in shares.items()}
        yield LatencyRow(
            participant=participant, simulated=simulated, stage=stage, pictures=pictures, **percentiles
        )


def find_total_latency_row(rows: Sequence[LatencyRow], *, simulated: bool) -> LatencyRow | None:
    """Returns the row with the total latency of all people, or of all simulated participants.

    If there is no such row, returns ``None``.
    """
    return next(
        (
            row
            for row in rows
            if row.simulated is simulated and row.participant is None and row.stage == TOTAL_LATENCY_KEY
        ),
        None,
    )


LATENCY_METHOD_TEXT = (
    "Latency: for every tracking frame, the client measures when the pose was read and sent, when the resulting state "
    "arrived, and when it was displayed. The server measures when the frame arrived, when it was simulated, and "
    "when the state was sent. The fastest messages of ten seconds synchronise the clocks. Percentiles are over the "
    "frames of analysed trials. The headset's display adds latency; the participant's own arms are drawn without this "
    "latency."
)


def render_latency_section(latencies: Sequence[LatencyRow], simulated: bool) -> Markup:
    """Returns the report section: latency of each stage, and the largest latency of a participant.

    The section is empty if there are no rows.
    """
    rows = [row for row in latencies if row.simulated is simulated]
    if not rows:
        return Markup()
    together = [row for row in rows if row.participant is None]
    words = {TOTAL_LATENCY_KEY: "from pose to frame", **STAGE_LABELS}
    body = [
        (words[row.stage], *(f"{ms:.1f}" for ms in (row.p50_ms, row.p95_ms, row.p99_ms))) for row in together
    ]
    own = [row for row in rows if row.participant is not None and row.stage == TOTAL_LATENCY_KEY]
    latest = max(own, key=lambda row: row.p95_ms)
    heads = ("Stage", "Median / ms", "95th percentile / ms", "99th percentile / ms")
    caption = format_group_caption(
        f"Latency from pose to frame over {together[0].pictures} frames", simulated
    )
    note = f"Largest 95th percentile: {latest.p95_ms:.1f} ms, participant {latest.participant}."
    return tag(
        "section",
        tag("h3", "Latency"),
        render_table(caption, heads, body, numbers=range(1, 4)),
        tag("p", note),
    )
