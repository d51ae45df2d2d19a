"""100 000 initial states without overlaps, as many random steps, and contact forces: `make soak`."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest

from avrgym.models.human import (
    LOWER_LIMITS_RAD,
    SEATED_POSE_RAD,
    TORSO_HEIGHT_RANGE_M,
    UPPER_LIMITS_RAD,
    Person,
)
from avrgym.people.distributions import POPULATION_DISTRIBUTIONS
from avrgym.people.population_names import IMPAIRMENTS
from avrgym.simulation.start_clearance import NoClearanceError
from avrgym.tasks.constants import EPISODE_STEPS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import ENVIRONMENTS, TASKS
from helpers.simulation.contact_forces import MAX_FORCE_N, MOTIONS, peak_forces
from helpers.simulation.initial_states import deepest_overlap_m, first_step_forces
from helpers.simulation.worlds import assert_finite

STARTS_PER_POPULATION = 524
PERSONS = 200
CONTACT_WORLDS, CONTACT_STEPS = 11, 60
"""In each of 8 environments, 5 populations and 4 impairments: 1 760 resets for each motion."""

RANDOM_WORLDS = 512
"""Episodes of 200 steps are more than 100 000 steps in each environment."""

FITTED = "\n".join(
    ["cooperating = true", "[torso_height_m]", "man = [0.45, 0.7]", "woman = [0.42, 0.66]"]
    + [
        f"[poses.{task}]\nright_elbow_x = [-110.0, -20.0]\nright_shoulder_y = [5.0, 40.0]\nwaist_x = [-10.0, 20.0]"
        for task in TASKS
    ]
)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_100_000_initial_states_have_no_overlap_and_no_contact(environment: str, tmp_path: Path) -> None:
    file = tmp_path / "fitted.toml"
    file.write_text(FITTED)
    looked, drawn_again = 0, 0
    for people, impairment in product([*POPULATION_DISTRIBUTIONS, str(file)], IMPAIRMENTS):
        episodes = Episodes(environment, STARTS_PER_POPULATION, people=people, impairment=impairment)
        generators = [np.random.default_rng([seed, looked]) for seed in range(STARTS_PER_POPULATION)]
        episodes.reset(np.arange(STARTS_PER_POPULATION), generators)
        looked += STARTS_PER_POPULATION
        drawn_again += int((episodes.num_initial_state_samples > 1).sum())
        assert deepest_overlap_m(episodes) == 0.0, (people, impairment)
        assert first_step_forces(episodes).max() <= 10.0, (people, impairment)
    print(
        f"\n{environment}: {looked} starts, {100.0 * drawn_again / looked:.1f} % drawn again, none overlaps"
    )


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_100_000_random_steps_stay_finite_without_a_warning(
    environment: str, rng: np.random.Generator
) -> None:
    episodes = Episodes(environment, RANDOM_WORLDS, people="revised")
    generators = [np.random.default_rng(world) for world in range(RANDOM_WORLDS)]
    episodes.reset(np.arange(RANDOM_WORLDS), generators)
    assert_finite(episodes, rng, EPISODE_STEPS)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_fixed_people_in_any_pose_do_not_overlap_or_raise_an_error(environment: str) -> None:
    random = np.random.default_rng(5)
    refused = 0
    for number in range(PERSONS):
        pose = np.clip(
            SEATED_POSE_RAD + random.normal(0.0, 0.5, len(SEATED_POSE_RAD)),
            LOWER_LIMITS_RAD,
            UPPER_LIMITS_RAD,
        )
        person = Person(("man", "woman")[number % 2], float(random.uniform(*TORSO_HEIGHT_RANGE_M)), pose)
        episodes = Episodes(environment, 2, person=person, moving=number % 4 > 1, num_threads=1)
        try:
            episodes.reset(np.arange(2), [np.random.default_rng([number, world]) for world in range(2)])
        except NoClearanceError:
            refused += 1
            continue
        assert deepest_overlap_m(episodes) == 0.0
        if number % 4 < 2:  # commanded people start at their targets
            assert first_step_forces(episodes).max() <= 10.0
    print(f"\n{environment}: {PERSONS} persons, {refused} refused")


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_contact_forces_stay_below_the_limit_of_compliance(environment: str) -> None:
    """Includes people with tremor, who move against the robot."""
    peaks = {
        (people, impairment, how): float(
            peak_forces(environment, CONTACT_WORLDS, people, impairment, how, steps=CONTACT_STEPS).max()
        )
        for people, impairment, how in product(POPULATION_DISTRIBUTIONS, IMPAIRMENTS, MOTIONS)
    }
    largest = max(peaks, key=lambda kind: peaks[kind])
    by_how = {how: round(max(peaks[kind] for kind in peaks if kind[2] == how)) for how in MOTIONS}
    print(f"\n{environment}: at most {peaks[largest]:.0f} N, {largest}; {by_how}")
    assert peaks[largest] < MAX_FORCE_N
