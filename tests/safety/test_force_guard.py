"""The force guard: arms with a high contact force retract along their path; other arms are not affected."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pytest

from avrgym.array_types import BoolArray, FloatArray
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.safety.force_guard import (
    INTERVENTION_FORCE_LIMIT_FRACTION,
    RELEASE_FORCE_LIMIT_FRACTION,
    WAYPOINT_SPACING_RAD,
    ForceGuard,
)
from avrgym.safety.limits import QUASI_STATIC_LIMIT_N
from avrgym.tasks.episodes import Episodes
from helpers.simulation.contact_forces import actions_towards
from helpers.simulation.initial_states import reset_episodes

SCRATCHING = "avrgym/ScratchItchJaco-v1"
WORLDS = 8
Asked = Callable[[Episodes], FloatArray]


class Driven(NamedTuple):
    """Physics step by physics step: the largest force as a share of its limit, before and after the guard looked."""

    before: FloatArray
    after: FloatArray
    retracting: BoolArray
    joint_positions: FloatArray
    output: FloatArray


def at_the_person(episodes: Episodes) -> FloatArray:
    return actions_towards(episodes, np.arange(episodes.simulation.num_worlds) % 4)


def drive(asked: Asked, *, guarded: bool, steps: int = 40, worlds: int = WORLDS) -> Driven:
    episodes = reset_episodes(SCRATCHING, worlds, by_region=True)
    simulation = episodes.simulation
    guard = ForceGuard(simulation)
    ticks: list[tuple[FloatArray, ...]] = []
    for _ in range(steps):
        action = asked(episodes)
        for tick in range(DEFAULT_SUBSTEPS):
            before = share(simulation.compute_region_force_n())
            changed = guard.update(action if tick == 0 else None)
            if tick == 0:
                episodes.command_robots(guard.executed_action if guarded else action)
            elif guarded:
                simulation.command_robot(guard.executed_action, changed)
            simulation.step(1)
            after = share(simulation.compute_region_force_n())
            ticks.append(
                (
                    before,
                    after,
                    guard.retracting_mask,
                    simulation.get_joint_positions(),
                    guard.executed_action,
                )
            )
        episodes.evaluate_step(action)
    return Driven(*(np.stack(each) for each in zip(*ticks, strict=True)))


def share(force_n: FloatArray) -> FloatArray:
    return (force_n / QUASI_STATIC_LIMIT_N).max(axis=-1)


@pytest.fixture(scope="module")
def pushed() -> tuple[Driven, Driven]:
    """Robots that are driven at people, without a guard and with one."""
    return drive(at_the_person, guarded=False), drive(at_the_person, guarded=True)


def test_it_retracts_exactly_above_the_threshold(pushed):
    before, retracting = pushed[1].before, pushed[1].retracting
    begins = retracting & ~np.roll(retracting, 1, axis=0)
    assert begins.sum() >= 3
    assert (before[begins] > INTERVENTION_FORCE_LIMIT_FRACTION).all()
    assert retracting[before > INTERVENTION_FORCE_LIMIT_FRACTION].all()


def test_it_releases_only_below_the_release_share(pushed):
    before, retracting = pushed[1].before[1:], pushed[1].retracting
    ends = retracting[:-1] & ~retracting[1:]
    assert ends.sum() >= 3
    assert (before[ends] < RELEASE_FORCE_LIMIT_FRACTION).all()
    assert not (retracting[1:] & retracting[:-1] & (before < RELEASE_FORCE_LIMIT_FRACTION)).any()


def test_high_forces_are_lower_and_shorter_with_the_guard(pushed):
    without, guarded = pushed
    acted = guarded.retracting.any(axis=0)
    assert 3 <= acted.sum() < WORLDS
    assert (guarded.after.max(axis=0)[acted] < without.after.max(axis=0)[acted]).all()
    assert (
        2 * (guarded.after > INTERVENTION_FORCE_LIMIT_FRACTION).sum()
        < (without.after > INTERVENTION_FORCE_LIMIT_FRACTION).sum()
    )


def test_without_high_forces_it_changes_no_bit(pushed):
    without, guarded = pushed
    spared = ~guarded.retracting.any(axis=0)
    assert guarded.after[:, spared].any()
    assert guarded.joint_positions[:, spared].tobytes() == without.joint_positions[:, spared].tobytes()


def test_each_world_has_the_same_bits_alone(pushed):
    alone = drive(at_the_person, guarded=True, worlds=1)
    assert alone.retracting.any()
    assert alone.joint_positions[:, 0].tobytes() == pushed[1].joint_positions[:, 0].tobytes()


def test_it_retracts_along_the_path_of_the_arm(pushed):
    """Wherever an arm is that draws back, it was before: within what joints that press are off their way."""
    guarded = pushed[1]
    for world in np.nonzero(guarded.retracting.any(axis=0))[0]:
        ticks = np.nonzero(guarded.retracting[:, world])[0]
        for tick in ticks:
            way = guarded.joint_positions[:tick, world]
            off = np.abs(way - guarded.joint_positions[tick, world]).max(axis=-1).min()
            assert off < 5 * WAYPOINT_SPACING_RAD
        assert (np.abs(guarded.output[ticks, world]) <= 1.0).all()


def test_an_arm_without_a_path_stands_still():
    episodes = reset_episodes(SCRATCHING, 1, by_region=True)
    simulation = episodes.simulation
    guard = ForceGuard(simulation)
    guard.retracting_mask[:] = True
    simulation.compute_region_force_n = lambda: QUASI_STATIC_LIMIT_N[None]
    start = simulation.get_joint_positions()
    for _ in range(30):
        episodes.step(guard.begin_step(np.ones((1, 7))))
    assert np.abs(simulation.get_joint_positions() - start).max() < WAYPOINT_SPACING_RAD


def test_a_reset_clears_the_path(pushed):
    episodes = reset_episodes(SCRATCHING, 1, by_region=True)
    guard = ForceGuard(episodes.simulation)
    for _ in range(5):
        episodes.step(guard.begin_step(np.ones((1, 7))))
    episodes.reset(np.array([0]), [np.random.default_rng(1)])
    guard.reset(np.array([0]))
    assert not guard.retracting_mask.any()
    assert not guard.num_interventions.any()
    angles = episodes.simulation.get_joint_positions()
    assert (guard._path == angles[:, None]).all()
