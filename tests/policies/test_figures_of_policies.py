"""The results in the files of packaged policies are those of the present simulated world."""

import runpy

import pytest

from avrgym.learning.evaluation import evaluate
from avrgym.policies.trained_policies import Policy, find_packaged_policies
from avrgym.tasks.constants import SIMULATION_VERSION
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.system.paths import ROOT

MEASURING = runpy.run_path(str(ROOT / "research" / "measure_policies.py"))
PACKAGED_FOLDER = [
    (environment, kind) for environment in ENVIRONMENTS for kind in find_packaged_policies(environment)
]


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("environment", "kind"), PACKAGED_FOLDER)
def test_the_first_episodes_return(environment: str, kind: str) -> None:
    """The same bits where the C library rounds as where they were measured, and nearly the same elsewhere."""
    metadata = Policy.load(find_packaged_policies(environment)[kind]).metadata
    measured = metadata.measured
    assert measured["world_version"] == SIMULATION_VERSION
    assert "test" in measured.values() or "showing" in measured.values()
    found = evaluate(environment, kind, metadata.people, MEASURING["FIRST"], MEASURING["SEED"])
    assert found.reward_mean == pytest.approx(measured["first_reward_mean"], rel=1e-3)
