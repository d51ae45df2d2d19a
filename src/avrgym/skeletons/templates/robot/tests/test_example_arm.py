"""The robot is registered, and every task that it can do begins with it."""

import numpy as np

from avrgym.robots.registry import find_robot
from avrgym.robots.validation import check_robot
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.placement_check import check_placement
from avrgym.tasks.registry import ENVIRONMENTS


def test_its_record_is_whole() -> None:
    check_robot(find_robot("ExampleArm"))


def test_it_leaves_everybody_room() -> None:
    check_placement("ExampleArm")


def test_its_environments_begin() -> None:
    made = [environment for environment, (_, robot) in ENVIRONMENTS.items() if robot == "ExampleArm"]
    assert "avrgym/FeedingExampleArm-v1" in made
    for environment in made:
        episodes = Episodes(environment, 1)
        episodes.reset(np.arange(1), [np.random.default_rng(0)])
        assert np.isfinite(episodes.evaluate_state().observation).all()
