"""Links of a robot collide with each other only with the setting `self_collision`."""

import numpy as np
import pytest

from avrgym.models import collision_bits
from avrgym.models.robot import PREFIX
from avrgym.models.self_collision import collision_pairs
from avrgym.robots.registry import ROBOTS
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.settings import DEFAULTS, Settings

WORLDS, STEPS = 8, 60
MAX_DEPTH_M = 0.01


def depth_m(name: str, *, self_collision: bool) -> tuple[float, int]:
    """Largest overlap of links that may collide, and number of contacts, while the arm turns at full speed."""
    settings = Settings(self_collision=True) if self_collision else DEFAULTS
    episodes = Episodes(f"avrgym/ScratchItch{name}-v1", WORLDS, num_threads=1, settings=settings)
    episodes.reset(np.arange(WORLDS), [np.random.default_rng(world) for world in range(WORLDS)])
    model, deepest, contacts = episodes.simulation.model, 0.0, 0
    turning = np.random.default_rng(2).choice([-1.0, 1.0], (WORLDS, episodes.action_size))
    for _ in range(STEPS):
        episodes.step(turning)
        for world in range(WORLDS):
            data = episodes.simulation.batch.get_data(world)
            for contact in data.contact:
                if all(model.geom_contype[geom] == collision_bits.ROBOT.contype for geom in contact.geom):
                    contacts += 1
                    deepest = max(deepest, -float(contact.dist))
    return deepest, contacts


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize("name", ROBOTS)
def test_an_arm_stops_at_itself(name: str) -> None:
    deepest, contacts = depth_m(name, self_collision=True)
    assert contacts > 0
    assert deepest < MAX_DEPTH_M


def test_links_do_not_collide_by_default() -> None:
    assert depth_m("Gen3", self_collision=False) == (0.0, 0)


@pytest.mark.parametrize("name", ROBOTS)
def test_pairs_are_other_bodies_than_neighbours(name: str) -> None:
    """Pairs contain the hand and the base or the shoulder, and no link with its parent."""
    robot = ROBOTS[name]
    scene = Episodes(f"avrgym/ScratchItch{name}-v1", 1, settings=Settings(self_collision=True))
    model, pairs = scene.simulation.model, collision_pairs(robot, robot.arms["left"])
    assert pairs
    for pair in pairs:
        first, second = (model.body(PREFIX + body).id for body in pair)
        assert model.body_weldid[first] != model.body_weldid[second]
        assert first not in (model.body_parentid[second], second)
        assert (min(first, second) << 16) + max(first, second) not in model.exclude_signature
