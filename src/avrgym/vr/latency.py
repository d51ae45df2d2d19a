"""How late pictures are behind poses: percentiles over recorded frames, stage by stage."""

from collections.abc import Sequence

import numpy as np

from avrgym.recording.schema import Latency

STAGE_LABELS = {
    "sample_ms": "pose",
    "up_ms": "up",
    "simulate_ms": "simulation",
    "send_ms": "sending",
    "down_ms": "down",
    "draw_ms": "drawing",
}
"""What people read for each stage, in the order of the way."""
STAGES = tuple(STAGE_LABELS)
TOTAL = "total_ms"
"""From pose to picture."""
SHARES = {"p50": 50.0, "p95": 95.0, "p99": 99.0}


def is_complete(latency: Latency) -> bool:
    """Whether every frame has an entry for each stage."""
    return all(len(getattr(latency, stage)) == len(latency.sequence) for stage in STAGES)


def percentiles_ms(latencies: Sequence[Latency]) -> dict[str, dict[str, float]]:
    """By name of stage, and from pose to picture as ``total_ms``, the percentiles; empty where there is no frame."""
    stages = {stage: np.array([ms for each in latencies for ms in getattr(each, stage)]) for stage in STAGES}
    if not stages[STAGES[0]].size:
        return {}
    stages = {TOTAL: np.sum([*stages.values()], axis=0), **stages}
    return {
        stage: dict(zip(SHARES, np.percentile(ms, [*SHARES.values()]).tolist(), strict=True))
        for stage, ms in stages.items()
    }
