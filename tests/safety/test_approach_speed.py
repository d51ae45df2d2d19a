"""Approach speeds of people and tools: forces of impacts, and interventions of the force guard."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from avrgym.array_types import FloatArray
from avrgym.models.human import GEOMS
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.safety.approach_speed import MONITORED_DISTANCE_M, compute_effective_mass_kg
from avrgym.safety.force_guard import ForceGuard
from avrgym.safety.limits import (
    BODY_REGIONS,
    QUASI_STATIC_LIMIT_N,
    REGION_INDEX_OF_GEOM,
    compute_max_impact_speed_m_s,
)
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.simulation.state import State
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.task import Controller
from helpers.simulation.contact_forces import actions_towards
from helpers.simulation.initial_states import reset_episodes

FEEDING = "avrgym/FeedingPR2-v1"
WORLDS = 8
FAST_PEOPLE = "participants@1"
"""The motion of version 1 has the higher accelerations."""
LEANING_STEPS = 40
"""People who are fed lean to the spoon within four seconds."""
Asked = Callable[[Episodes], Controller]


def test_an_impact_at_the_maximum_speed_has_the_spring_energy_of_the_force():
    force_n = 0.5 * QUASI_STATIC_LIMIT_N
    for arm_mass_kg in (0.5, 3.0, 20.0, np.inf):
        speeds = compute_max_impact_speed_m_s(force_n, arm_mass_kg)
        for region, force, speed in zip(BODY_REGIONS, force_n, speeds, strict=True):
            together_kg = 1.0 / (1.0 / region.effective_mass_kg + 1.0 / arm_mass_kg)
            stored_j = force**2 / (2.0 * 1000.0 * region.spring_constant_n_mm)
            assert_allclose(0.5 * together_kg * speed**2, stored_j)
    assert (compute_max_impact_speed_m_s(force_n, 3.0) > compute_max_impact_speed_m_s(force_n, 20.0)).all()


@pytest.mark.parametrize(("robot", "least_kg", "most_kg"), [("Jaco", 2.0, 4.0), ("PR2", 15.0, 25.0)])
def test_the_effective_mass_is_half_the_arm_and_the_tool(robot: str, least_kg: float, most_kg: float):
    """A Jaco weighs 5 kg without its base; the shoulder of a PR2 turns with its whole arm, 41 kg."""
    assert (
        least_kg
        < compute_effective_mass_kg(reset_episodes(f"avrgym/Feeding{robot}-v1", 1).simulation)
        < most_kg
    )


def from_axis_m(point: FloatArray, ends: FloatArray) -> float:
    """How far a point is from an axis, tried along it."""
    along = np.linspace(0.0, 1.0, 4001)[:, None]
    return float(np.linalg.norm(ends[0] + along * (ends[1] - ends[0]) - point, axis=-1).min())


def shares(before: State, now: State, world: int, allowed_m_s: FloatArray) -> tuple[float, float]:
    """How fast somebody came to the tool, and both together, as shares of what is allowed; of the fastest near one."""
    found = [[0.0, 0.0]]
    for index, name in enumerate(GEOMS):
        was, ends = before.person_capsule_ends_w[world, index], now.person_capsule_ends_w[world, index]
        pad, pad_before = now.tool_pad_pos_w[world], before.tool_pad_pos_w[world]
        now_m, limit_m = from_axis_m(pad, ends), CONTROL_STEP_S * allowed_m_s[REGION_INDEX_OF_GEOM[name]]
        gap_m = now_m - now.person_radius_m[world, index]
        closed_m = [from_axis_m(place, was) - now_m for place in (pad, pad_before)]
        found.append([each / limit_m if gap_m - each < MONITORED_DISTANCE_M else 0.0 for each in closed_m])
    people, both = zip(*found, strict=True)
    return max(people), max(both)


@pytest.mark.slow
def test_the_guard_overrides_exactly_above_the_speed_limits():
    """Arms that are led at people who come to meet them: each world, step by step, worked out once more alone."""
    episodes = reset_episodes(FEEDING, WORLDS, "participants", by_region=True)
    simulation = episodes.simulation
    guard, before = ForceGuard(simulation), simulation.get_state()
    allowed_m_s = compute_max_impact_speed_m_s(
        0.5 * QUASI_STATIC_LIMIT_N, compute_effective_mass_kg(simulation)
    )
    leads = episodes.task.feedback_expert(episodes)
    seen: list[tuple[bool, bool]] = []
    for _ in range(LEANING_STEPS):
        now, asked = simulation.get_state(), np.clip(leads(episodes.observe()), -1.0, 1.0)
        given = guard.begin_step(asked)
        for world in range(WORLDS):
            people, both = shares(before, now, world, allowed_m_s)
            if min(abs(people - 1.0), abs(both - 1.0)) < 1e-3 or guard._pressed[world]:
                continue
            seen.append((people > 1.0, both > 1.0))
            assert guard.retracting_mask[world] == (people > 1.0)
            assert guard.stopped_mask[world] == (both > 1.0 and people <= 1.0)
            if guard.stopped_mask[world]:
                assert not given[world].any()
            elif not guard.override_mask[world]:
                assert_array_equal(given[world], asked[world])
            if guard.override_mask[world]:
                what = "approaches" if guard.retracting_mask[world] else "and tool approach"
                assert f" {what} at " in guard.describe_override(world)
        before = now
        episodes.step(given)
    by_person, together = np.array(seen).T
    for kind in (by_person, together & ~by_person, ~by_person & ~together):
        assert kind.sum() >= 10


def test_no_intervention_while_person_and_arm_rest():
    episodes = reset_episodes(FEEDING, WORLDS, by_region=True)
    guard = ForceGuard(episodes.simulation)
    asked = np.zeros((WORLDS, episodes.action_size))
    for _ in range(10):
        episodes.step(guard.begin_step(asked))
    assert not guard.num_interventions.any()


def largest_shares(environment: str, people: str, asked: Asked) -> tuple[FloatArray, FloatArray]:
    """What people bear without a guard and with one, the largest share (N,) of a region's limit."""
    found: list[FloatArray] = []
    for guarded in (False, True):
        episodes = reset_episodes(environment, WORLDS, people, by_region=True, force_guard=guarded)
        recorder, ask = RegionLoadRecorder(WORLDS), asked(episodes)
        for _ in range(LEANING_STEPS):
            episodes.step(np.clip(ask(episodes.observe()), -1.0, 1.0), recorder)
        found.append((recorder.compute_loads().peak_force_n / QUASI_STATIC_LIMIT_N).max(axis=-1))
    return found[0], found[1]


@pytest.mark.slow
def test_heads_that_approach_a_spoon_have_no_impact():
    without, guarded = largest_shares(FEEDING, FAST_PEOPLE, lambda each: each.task.feedback_expert(each))
    assert (without > 1.0).sum() >= 2
    assert (guarded < 0.75).all()


def test_arms_commanded_at_full_speed_approach_heads_slowly():
    heads = np.zeros(WORLDS, dtype=np.intp)
    without, guarded = largest_shares(
        "avrgym/FeedingJaco-v1", "revised", lambda each: lambda observation: actions_towards(each, heads)
    )
    assert (without > 1.0).sum() >= WORLDS // 2
    assert (guarded < 1.0).all()
