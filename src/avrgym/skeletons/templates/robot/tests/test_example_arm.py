"""Tests of the robot: it is registered, and its environments reset."""

import numpy as np

from avrgym.robots.registry import find_robot
from avrgym.robots.validation import check_robot
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.placement_check import check_placement
from avrgym.tasks.registry import ENVIRONMENTS


def test_record_is_valid() -> None:
    check_robot(find_robot("ExampleArm"))


def test_placement_is_valid() -> None:
    check_placement("ExampleArm")


def test_environments_reset() -> None:
    environments = [environment for environment, (_, robot) in ENVIRONMENTS.items() if robot == "ExampleArm"]
    assert "avrgym/FeedingExampleArm-v1" in environments
    for environment in environments:
        episodes = Episodes(environment, 1)
        episodes.reset(np.arange(1), [np.random.default_rng(0)])
        assert np.isfinite(episodes.evaluate_state().observation).all()
