"""Reward of feeding: food in the mouth, and the preferences of the person."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from avrgym.array_types import BoolArray, FloatArray
from avrgym.geometry.arrays import constant_like, get_namespace
from avrgym.geometry.transforms import norm
from avrgym.models.furniture import BOWL_BODY, TABLE_HEIGHT_M, PositionOffset
from avrgym.models.human import People
from avrgym.models.spoon import FOOD
from avrgym.simulation.worlds import State
from avrgym.tasks.particles import (
    FLOOR_HEIGHT_M,
    check_particle_count,
    count_events,
    find_particles_on_person,
)
from avrgym.tasks.person import zero_comfortable_forces
from avrgym.tasks.task import StepResult

MOUTH_RADIUS_M = 0.02
MAX_DROPPED_FOOD_HEIGHT_M = 0.5
SUCCESS_FOOD_FRACTION = 0.75
BOWL_RADIUS_M, BOWL_HEIGHT_M = 0.07, 0.05
TABLE_MIN_CORNER_M, TABLE_MAX_CORNER_M = np.array([-0.30, -1.32]), np.array([1.00, -0.48])
REWARD_WEIGHTS: Mapping[str, float] = {
    "distance_m": -1.0,
    "action_squared": -0.01,
    "food_in_mouth": 20.0,
    "food_dropped": -5.0,
    "tool_speed_m_s": -0.25,
    "strong_tool_force_n": -0.05,
    "links_force_n": -0.01,
    "food_on_person": -1.0,
    "food_entry_speed_m_s": -1.0,
}
"""Weights of the reward terms: first of the task, then of the person's preferences (paper, section IV, and its
code).
"""


@dataclass(frozen=True)
class FeedingState:
    """Task state: boolean masks (N, K) of K pieces of food in N worlds. Eaten and dropped pieces have no further
    events.
    """

    eaten: BoolArray
    dropped: BoolArray
    on_person: BoolArray


def make_initial_task_state(
    people: People, uniforms: FloatArray, particles: int = len(FOOD.initial_pos)
) -> FeedingState:
    """Returns the initial task state of N worlds: none of ``particles`` pieces of food is eaten or dropped."""
    xp = get_namespace(uniforms)
    nothing = xp.zeros((len(uniforms), particles), dtype=xp.bool, device=uniforms.device)
    return FeedingState(nothing, nothing, nothing)


def evaluate_step(
    state: State,
    action: FloatArray,
    task_state: FeedingState,
    table_offset_m: PositionOffset = (0.0, 0.0, 0.0),
) -> StepResult:
    """Returns the result of a step. Food within 2 cm of the mouth is eaten.

    Food below 0.5 m, on the table or in the bowl is dropped. Eaten food, and food on the floor, is removed from the
    scene.
    """
    check_particle_count(state, task_state.eaten)
    in_play = ~(task_state.eaten | task_state.dropped)
    newly_eaten = in_play & (norm(state.particle_pos_w - state.mouth_pos_w[:, None]) < MOUTH_RADIUS_M)
    newly_dropped = in_play & ~newly_eaten & _is_dropped(state, table_offset_m)
    newly_on_person = find_particles_on_person(
        state, FOOD.radius_m, in_play & ~newly_eaten & ~task_state.on_person
    )
    after = FeedingState(
        task_state.eaten | newly_eaten,
        task_state.dropped | newly_dropped,
        task_state.on_person | newly_on_person,
    )
    distance = norm(state.tool_pos_w - state.mouth_pos_w)
    speed = norm(state.particle_velocity_w)
    terms = {
        "distance_m": distance,
        "action_squared": (action * action).sum(axis=-1),
        "food_in_mouth": count_events(newly_eaten),
        "food_dropped": count_events(newly_dropped),
        "tool_speed_m_s": norm(state.tool_velocity_w),
        "strong_tool_force_n": compute_strong_tool_force_n(state),
        "links_force_n": state.links_force_n,
        "food_on_person": count_events(newly_on_person),
        "food_entry_speed_m_s": get_namespace(speed).where(newly_eaten, speed, 0.0).sum(axis=-1),
    }
    success = after.eaten.sum(axis=-1) >= SUCCESS_FOOD_FRACTION * after.eaten.shape[-1]
    gone = newly_eaten | (after.dropped & (state.particle_pos_w[..., 2] < FLOOR_HEIGHT_M))
    eaten = newly_eaten.sum(axis=-1)
    return StepResult(after, terms, distance, state.total_force_n, success, eaten, gone)


def compute_strong_tool_force_n(state: State) -> FloatArray:
    """Returns the contact force (N,) of the tool on the person in newtons. Forces below ``COMFORT_FORCE_LIMIT_N``
    become 0."""
    return zero_comfortable_forces(state.tool_contact_force_n.sum(axis=-1))


def _is_dropped(state: State, table_offset_m: PositionOffset) -> BoolArray:
    pos = state.particle_pos_w
    from_table = pos - constant_like(np.array(table_offset_m), pos)
    low, high = constant_like(TABLE_MIN_CORNER_M, pos), constant_like(TABLE_MAX_CORNER_M, pos)
    over_table = ((from_table[..., :2] > low) & (from_table[..., :2] < high)).all(axis=-1)
    on_table = over_table & (from_table[..., 2] < TABLE_HEIGHT_M + 2.0 * FOOD.radius_m)
    from_bowl = pos - state.furniture_pos_w[BOWL_BODY][:, None]
    above_bowl = norm(from_bowl[..., :2]) < BOWL_RADIUS_M
    in_bowl = above_bowl & (from_bowl[..., 2] < BOWL_HEIGHT_M + 2.0 * FOOD.radius_m)
    return (pos[..., 2] < MAX_DROPPED_FOOD_HEIGHT_M) | on_table | in_bowl
