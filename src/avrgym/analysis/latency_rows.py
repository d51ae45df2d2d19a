"""How late pictures were behind poses: the table, from what recordings tell of every frame."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from avrgym.analysis.rows import TrialRow
from avrgym.recording.schema import Latency
from avrgym.vr.latency import TOTAL, percentiles_ms

Latencies = Mapping[tuple[str, int], Sequence[Latency]]
"""What the client told during trials, by pseudonym and position."""


@dataclass(frozen=True, kw_only=True)
class LatencyRow:
    """How long a stage took on the way from pose to picture, or all of them as ``total_ms``.

    Percentiles are over the pictures of counted trials. ``participant`` is missing for all of a kind
    together.
    """

    participant: str | None
    simulated: bool
    stage: str
    pictures: int
    p50_ms: float
    p95_ms: float
    p99_ms: float


def latency_rows(trials: Sequence[TrialRow], latencies: Latencies) -> list[LatencyRow]:
    """People first, each group before its participants; nothing of who was never shown a picture, as in simulation."""
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
    for stage, shares in percentiles_ms(told).items():
        percentiles = {f"{share}_ms": ms for share, ms in shares.items()}
        yield LatencyRow(
            participant=participant, simulated=simulated, stage=stage, pictures=pictures, **percentiles
        )


def total_of(rows: Sequence[LatencyRow], *, simulated: bool) -> LatencyRow | None:
    """From pose to picture, over all people or all simulated participants."""
    return next(
        (
            row
            for row in rows
            if row.simulated is simulated and row.participant is None and row.stage == TOTAL
        ),
        None,
    )
