"""Many stops of moving arms: `make soak`."""

import pytest

from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.random_stops import MAX_REBOUND_M, SLOW_M_S, stop_at_random

STOPS, MOMENTS = 25, 8


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_a_stopped_arm_is_slow_after_100_ms_without_rebound(environment: str) -> None:
    """200 stops in each environment, at eight times."""
    for seed in range(MOMENTS):
        stops = stop_at_random(environment, STOPS, seed)
        print(f"\n{environment}: {stops}", end="")
        assert stops.residual_speed_m_s.max() < SLOW_M_S
        assert stops.rebound_m.max() < MAX_REBOUND_M
        assert stops.drift_m.max() < MAX_REBOUND_M
