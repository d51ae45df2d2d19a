"""Links of a robot collide with each other only with the setting `self_collision`."""

from collections import Counter
from typing import Any

import mujoco
import numpy as np
import pytest

from avrgym.models import collision_bits
from avrgym.models.robot import ROBOT_NAME_PREFIX, build_robot_spec
from avrgym.models.self_collision import find_collision_pairs
from avrgym.robots.registry import ROBOTS
from avrgym.simulation import base_search
from avrgym.tasks import placement
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import find_task_and_scene
from avrgym.tasks.robot_clearance import (
    _robot_capsules,
    compute_min_self_distance_m,
    make_self_collision_shape,
)
from avrgym.tasks.settings import DEFAULT_SETTINGS, Settings

WORLDS, STEPS = 8, 60
MAX_DEPTH_M = 0.01


def depth_m(name: str, *, self_collision: bool) -> tuple[float, int]:
    """Largest overlap of links that may collide, and number of contacts, while the arm turns at full speed."""
    settings = Settings(self_collision=True) if self_collision else DEFAULT_SETTINGS
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
    model, pairs = scene.simulation.model, find_collision_pairs(robot, robot.arms["left"])
    assert pairs
    for pair in pairs:
        first, second = (model.body(ROBOT_NAME_PREFIX + body).id for body in pair)
        assert model.body_weldid[first] != model.body_weldid[second]
        assert first not in (model.body_parentid[second], second)
        assert (min(first, second) << 16) + max(first, second) not in model.exclude_signature


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize("name", ROBOTS)
def test_links_that_touch_have_no_distance(name: str) -> None:
    """The capsules of the start search contain the links: where links collide, their distance is not positive."""
    _, scene = find_task_and_scene(f"avrgym/ScratchItch{name}-v1", Settings(self_collision=True))
    chain = placement.make_planning_chain(scene)
    shape = make_self_collision_shape(scene, chain)
    bodies = [capsule.body for capsule in _robot_capsules(scene)]
    kept = Counter(frozenset(bodies[each] for each in pair) for pair in shape.capsule_pairs.tolist())
    checked = {
        pair for pair, count in kept.items() if count == np.prod([bodies.count(each) for each in pair])
    }
    model = build_robot_spec(
        scene.robot, scene.arm, scene.robot.grips[scene.tool.grip_name], appearance=False
    )
    for geom in model.geoms:
        geom.contype = geom.conaffinity = 1
    compiled = model.compile()
    data, positions = mujoco.MjData(compiled), [compiled.joint(each).qposadr[0] for each in scene.arm.joints]
    travel, touching = len(chain.lower_limit) - len(positions), 0
    for pose in np.random.default_rng(0).uniform(
        chain.lower_limit[travel:], chain.upper_limit[travel:], (300, len(positions))
    ):
        data.qpos[positions] = pose
        mujoco.mj_kinematics(compiled, data)
        mujoco.mj_collision(compiled, data)
        pairs = compiled.geom_bodyid[data.contact.geom].tolist()
        found = {frozenset(compiled.body(body).name for body in pair) for pair in pairs}
        if found & checked:
            touching += 1
            assert compute_min_self_distance_m(scene, chain, np.append(np.zeros(travel), pose)[None]) < 1e-6
    assert touching > 0


def test_bases_have_clear_ways_to_the_goals(monkeypatch: pytest.MonkeyPatch) -> None:
    """With self-collision, the cost of the chosen base is not higher than without."""
    chosen: list[Any] = []
    search = base_search.search_base_pose

    def recorded(*arguments: Any) -> Any:
        chosen.append((arguments[-1], search(*arguments)))
        return chosen[-1][1]

    monkeypatch.setattr(placement.base_search, "search_base_pose", recorded)
    for on in (False, True):
        settings = Settings(self_collision=on, control_hz=20)
        episodes = Episodes("avrgym/ScratchItchPR2-v1", 3, num_threads=1, settings=settings)
        episodes.reset(np.arange(3), [np.random.default_rng(world) for world in range(3)])
    (_, without), (path_cost, with_ways) = chosen[0], next(each for each in chosen if each[0] is not None)
    costs = [
        path_cost(
            found.base_poses.pos_w[:, None], found.base_poses.yaw_rad[:, None], found.joint_positions[:, None]
        )
        for found in (without, with_ways)
    ]
    assert (costs[1] <= costs[0] + 1e-6).all()
