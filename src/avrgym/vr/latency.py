"""Latency from tracking to display: percentiles over recorded frames, for each stage and in total."""

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
"""Labels of the stages between tracking and display, in order."""
LATENCY_STAGES = tuple(STAGE_LABELS)
TOTAL_LATENCY_KEY = "total_ms"
"""Key of the total latency from tracking to display."""
LATENCY_PERCENTILES = {"p50": 50.0, "p95": 95.0, "p99": 99.0}


def has_all_stages(latency: Latency) -> bool:
    """Returns whether every frame has an entry for each stage."""
    return all(len(getattr(latency, stage)) == len(latency.sequence) for stage in LATENCY_STAGES)


def compute_percentiles_ms(latencies: Sequence[Latency]) -> dict[str, dict[str, float]]:
    """Returns percentiles in milliseconds for each stage, and for the total latency (``total_ms``); empty without
    frames."""
    stages = {
        stage: np.array([ms for each in latencies for ms in getattr(each, stage)]) for stage in LATENCY_STAGES
    }
    if not stages[LATENCY_STAGES[0]].size:
        return {}
    stages = {TOTAL_LATENCY_KEY: np.sum([*stages.values()], axis=0), **stages}
    return {
        stage: dict(
            zip(LATENCY_PERCENTILES, np.percentile(ms, [*LATENCY_PERCENTILES.values()]).tolist(), strict=True)
        )
        for stage, ms in stages.items()
    }
