"""Comparisons of all vector environments and evaluations: `make soak`."""

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from avrgym.learning.evaluation import evaluate_all
from avrgym.tasks.registry import ENVIRONMENTS
from helpers.simulation.vector_environments import WORLDS, compare

STEPS = 100


@pytest.mark.parametrize("people", ["revised", "participants"])
def test_vector_environment_equals_gymnasium_in_every_mode(people: str, rng: np.random.Generator) -> None:
    """Every environment, mode and population, with random resets."""
    ends = sum(
        compare(environment, mode, STEPS, rng, people)
        for environment in ENVIRONMENTS
        for mode in AutoresetMode
    )
    steps = len(ENVIRONMENTS) * len(AutoresetMode) * STEPS
    print(f"\n{people}: {steps} steps of {WORLDS} worlds, {ends} ends of episodes, no bit differs")
    assert ends > steps * WORLDS // 20


@pytest.mark.parametrize("environment", ENVIRONMENTS)
@pytest.mark.parametrize("policy", ["oracle", "revised", "random"])
def test_rows_do_not_depend_on_the_number_of_processes(environment: str, policy: str) -> None:
    rows = [evaluate_all([environment], policy, "participants", 7, 3, jobs=jobs) for jobs in (1, 2, 3)]
    assert rows[0] == rows[1] == rows[2]
