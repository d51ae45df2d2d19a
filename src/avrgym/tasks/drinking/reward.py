"""Reward of drinking: water in the mouth, and the preferences of the person."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry import elementary, transforms
from avrgym.geometry.arrays import get_namespace
from avrgym.geometry.transforms import norm
from avrgym.models.cup import DEFAULT_CUP_SHAPE, WATER, CupShape
from avrgym.models.human import People
from avrgym.simulation.worlds import State
from avrgym.tasks.feeding.reward import compute_strong_tool_force_n
from avrgym.tasks.particles import (
    FLOOR_HEIGHT_M,
    check_particle_count,
    count_events,
    find_particles_on_person,
)
from avrgym.tasks.task import StepResult

MOUTH_RADIUS_M = 0.03
SUCCESS_WATER_FRACTION = 0.75
REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "off_horizontal_rad": -0.1,
    "water_in_mouth": 10.0,
    "water_spilled": -1.0,
    "tool_speed_m_s": -0.25,
    "strong_tool_force_n": -0.05,
    "links_force_n": -0.01,
    "water_on_person": -1.0,
    "water_entry_speed_m_s": -1.0,
}
"""Weights of the reward terms: first of the task, then of the person's preferences (paper, section IV, and its code).

The distance is from the pouring edge of the rim to the mouth. ``off_horizontal_rad`` is the angle of the cup's axis
from the horizontal.
"""


@dataclass(frozen=True)
class DrinkingState:
    """Task state: boolean masks (N, K) of K water particles in N worlds. ``drunk`` particles are in the mouth, ``gone``
    particles have been removed from the scene.
    """

    drunk: BoolArray
    spilled: BoolArray
    on_person: BoolArray
    gone: BoolArray


def make_initial_task_state(
    people: People, uniforms: FloatArray, particles: int = len(WATER.initial_pos)
) -> DrinkingState:
    """Returns the initial task state of N worlds: all water (``particles`` particles) is in the cup."""
    xp = get_namespace(uniforms)
    nothing = xp.zeros((len(uniforms), particles), dtype=xp.bool, device=uniforms.device)
    return DrinkingState(nothing, nothing, nothing, nothing)


def evaluate_step(
    state: State, action: FloatArray, task_state: DrinkingState, cup: CupShape = DEFAULT_CUP_SHAPE
) -> StepResult:
    """Returns the result of a control step.

    Water outside the cup within 3 cm of the mouth is drunk. Water below cup and mouth is spilled.
    """
    check_particle_count(state, task_state.drunk)
    outside = ~(task_state.gone | is_in_cup(state, cup))
    drinkable = outside & ~task_state.spilled
    drunk = drinkable & (norm(state.particle_pos_w - state.mouth_pos_w[:, None]) < MOUTH_RADIUS_M)
    spilled = drinkable & ~drunk & _fallen(state, cup)
    on_person = find_particles_on_person(state, WATER.radius_m, outside & ~drunk & ~task_state.on_person)
    gone = drunk | (outside & (state.particle_pos_w[..., 2] < FLOOR_HEIGHT_M))
    after = DrinkingState(
        task_state.drunk | drunk,
        task_state.spilled | spilled,
        task_state.on_person | on_person,
        task_state.gone | gone,
    )
    xp = get_namespace(state.tool_pos_w)
    distance = norm(state.tool_pos_w - state.mouth_pos_w)
    terms = {
        "distance_m": distance,
        "action_squared": (action * action).sum(axis=-1),
        "off_horizontal_rad": xp.abs(compute_cup_tilt_rad(state) - 0.5 * np.pi),
        "water_in_mouth": count_events(drunk),
        "water_spilled": count_events(spilled),
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "strong_tool_force_n": compute_strong_tool_force_n(state),
        "links_force_n": state.links_force_n,
        "water_on_person": count_events(on_person),
        "water_entry_speed_m_s": xp.where(drunk, norm(state.particle_velocity_w), 0.0).sum(axis=-1),
    }
    success = after.drunk.sum(axis=-1) >= SUCCESS_WATER_FRACTION * after.drunk.shape[-1]
    return StepResult(after, terms, distance, state.total_force_n, success, drunk.sum(axis=-1), gone)


def is_in_cup(state: State, cup: CupShape = DEFAULT_CUP_SHAPE) -> BoolArray:
    """Returns a boolean mask (N, K) of water particles inside the cup, below its rim."""
    to_cup = transforms.conjugate(state.tool_quat_w)[:, None]
    pos = transforms.rotate(to_cup, state.particle_pos_w - state.tool_pos_w[:, None])
    beside = (pos[..., 0] - cup.axis_x_m) ** 2 + pos[..., 1] ** 2 > cup.rim_radius_m**2
    return ~beside & (pos[..., 2] < 0.0) & (pos[..., 2] > -cup.height_m)


def _fallen(state: State, cup: CupShape) -> BoolArray:
    """Returns a boolean mask (N, K) of water particles below the lowest points of cup and mouth."""
    middle = (
        transforms.rotate(state.tool_quat_w, [cup.axis_x_m, 0.0, -0.5 * cup.height_m])[:, 2]
        + state.tool_pos_w[:, 2]
    )
    cup_low = middle - float(np.hypot(cup.rim_radius_m, 0.5 * cup.height_m))
    mouth_low = state.mouth_pos_w[:, 2] - MOUTH_RADIUS_M
    return state.particle_pos_w[..., 2] < get_namespace(cup_low).minimum(cup_low, mouth_low)[:, None]


def compute_cup_tilt_rad(state: State) -> FloatArray:
    """Returns the angle (N,) between the cup's axis and the vertical."""
    up = transforms.rotate(state.tool_quat_w, [0.0, 0.0, 1.0])[:, 2]
    return elementary.arccos(get_namespace(up).clip(up, -1.0, 1.0))
