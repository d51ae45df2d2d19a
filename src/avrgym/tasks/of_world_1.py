"""How AVR Gym 0.1.0 (world version 1) rewarded, so that its recordings verify; to be deleted with the last of them.

It counted the speed of the end effector, not of the tool, and net forces; feeding and drinking did not mind a strong
force of the tool; a cup was the better the further it was tilted; every side of the washcloth wiped.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from avrgym.geometry import transforms
from avrgym.geometry.transforms import norm
from avrgym.simulation.worlds import State
from avrgym.tasks.bed_bathing.task import BED_BATHING
from avrgym.tasks.drinking.reward import tilt_rad
from avrgym.tasks.drinking.task import DRINKING
from avrgym.tasks.feeding.task import FEEDING
from avrgym.tasks.scratch_itch.task import SCRATCH_ITCH
from avrgym.tasks.task import StepResult, Task, TaskState

Array = NDArray[np.float64]


def _as_of_world_1(task: Task, weights: Mapping[str, float]) -> Task:
    """The task with these weights, whose terms are its own or those of 0.1.0."""

    def evaluate_step(state: State, action: Array, task_state: TaskState) -> StepResult:
        result = task.evaluate_step(_as_it_was_seen(state), action, task_state)
        terms = {**result.terms, **_terms(state)}
        return replace(
            result, terms={name: terms[name] for name in weights}, force_on_person_n=state.robot_force_n
        )

    return replace(task, weights=weights, evaluate_step=evaluate_step)


def _as_it_was_seen(state: State) -> State:
    """Net forces, and contacts that all lie before the pad and press straight on its face."""
    face_w = transforms.rotate(state.pad_q_w, [1.0, 0.0, 0.0])
    return replace(
        state,
        total_force_n=state.robot_force_n,
        pad_pos_w=state.pad_pos_w - 10.0 * face_w,
        tool_contact_normal_w=np.broadcast_to(face_w[:, None], state.tool_contact_normal_w.shape),
    )


def _terms(state: State) -> Mapping[str, Array]:
    return {
        "tilt_rad": tilt_rad(state),
        "effector_speed_m_s": norm(state.effector_velocity_w),
        "force_on_person_n": state.robot_force_n,
    }


TASKS: Mapping[str, Task] = {
    task.name: _as_of_world_1(task, weights)
    for task, weights in (
        (
            FEEDING,
            {
                "distance_m": -1.0,
                "action_squared": -0.01,
                "food_in_mouth": 20.0,
                "food_dropped": -5.0,
                "effector_speed_m_s": -0.25,
                "force_on_person_n": -0.01,
                "food_on_person": -1.0,
                "food_entry_speed_m_s": -1.0,
            },
        ),
        (
            DRINKING,
            {
                "distance_m": -1.0,
                "action_squared": -0.01,
                "tilt_rad": 0.1,
                "water_in_mouth": 10.0,
                "water_spilled": -1.0,
                "effector_speed_m_s": -0.25,
                "force_on_person_n": -0.01,
                "water_on_person": -1.0,
                "water_entry_speed_m_s": -1.0,
            },
        ),
        (
            SCRATCH_ITCH,
            {
                "distance_m": -1.0,
                "action_squared": -0.01,
                "force_at_itch_n": 0.01,
                "scratch_force_n": 2.0,
                "effector_speed_m_s": -0.25,
                "force_elsewhere_n": -0.01,
                "strong_force_at_itch_n": -0.05,
            },
        ),
        (
            BED_BATHING,
            {
                "distance_m": -1.0,
                "action_squared": -0.01,
                "markers_wiped": 5.0,
                "effector_speed_m_s": -0.25,
                "force_elsewhere_n": -0.01,
                "strong_force_at_arm_n": -0.05,
            },
        ),
    )
}
