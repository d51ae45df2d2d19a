"""What packaged policies say of themselves is what they reach in today's world."""

import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained import Policy, packaged_policies
from avrgym.simulation.world_version import WORLD_VERSION
from avrgym.tasks.registry import ENVIRONMENTS


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_figures_were_measured_in_todays_world(environment: str) -> None:
    for path in packaged_policies(environment).values():
        assert Policy.load(path).metadata.measured["world_version"] == WORLD_VERSION


@pytest.mark.slow
def test_a_row_of_the_figures_returns() -> None:
    """The same bits where the C library rounds as where it was measured, and nearly the same elsewhere."""
    environment, kind = "avrgym/ScratchItchPR2-v1", "revised"
    metadata = Policy.load(packaged_policies(environment)[kind]).metadata
    found = evaluate(environment, kind, metadata.people, int(metadata.measured["episodes"]), seed=0)
    assert found.success_rate == metadata.measured["success_rate"]
    for name in ("reward_mean", "reward_std", "force_mean_newton"):
        assert getattr(found, name) == pytest.approx(metadata.measured[name], rel=1e-3)
