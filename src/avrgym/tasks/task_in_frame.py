"""Converts tasks to scenes with the other arm of the person, or with another height of seat or bed.

The functions of a task compute in the task's frame, see ``models.task_frame``. Wrappers convert arguments from the
world frame to the task's frame, and results back. A task therefore needs no code for the other arm.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, cast

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry.arrays import constant_like
from avrgym.models.body_names import TrackedBodyPart
from avrgym.models.human import People
from avrgym.models.scene import SceneConfig
from avrgym.models.task_frame import (
    OPPOSITE_GEOM_INDICES,
    X_AXIS_INDEX,
    Y_AXIS_INDEX,
    TaskFrame,
    opposite_side_name,
)
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.people.distributions import Pose
from avrgym.simulation.state import ArmPoses
from avrgym.simulation.worlds import InitialState, Simulation, State
from avrgym.tasks.observation import EntryFunction, Observation
from avrgym.tasks.task import (
    Controller,
    Expert,
    Marks,
    RunningEpisodes,
    StepResult,
    Task,
    TaskState,
    View,
    Views,
)

_OTHER_SIDE: dict[TrackedBodyPart, TrackedBodyPart] = {"right": "left", "left": "right"}
_OTHER_PART: dict[OfferedBodyPart, OfferedBodyPart] = {"arm": "left_arm", "left_arm": "arm"}
_POINTS = (
    "robot_pos_w", "tool_pos_w", "pad_pos_w", "head_pos_w", "mouth_pos_w", "particle_pos_w", "cloth_pos_w",
    "tool_contact_pos_w",
)  # fmt: skip
_VECTORS = ("effector_velocity_w", "tool_velocity_w", "particle_velocity_w", "tool_contact_normal_w")
_BASE_SIGNS = np.array([1.0, -1.0, -1.0])
"""Factors of the displacement of a driving base in a mirrored world: x, y and yaw."""


def task_in_frame(task: Task, frame: TaskFrame, mirror_axis: int) -> Task:
    """Returns a task for scenes in the world frame, with functions that compute in the task's frame ``frame``.

    ``mirror_axis`` is the axis of the tool's frame that is normal to the tool's plane of symmetry.
    """
    wrapped = _Wrapped(task, frame, mirror_axis)
    changed = replace(
        task,
        start=wrapped.start,
        init_state=wrapped.init_state,
        observation=wrapped.observation,
        evaluate_step=wrapped.evaluate_step,
        expert=partial(wrapped.control, task.expert),
        feedback_expert=partial(wrapped.control, task.feedback_expert),
        memory_expert=None if task.memory_expert is None else partial(wrapped.control, task.memory_expert),
        detour_m=None if task.detour_m is None else partial(wrapped.detour, task.detour_m),
        marks=None if task.marks is None else wrapped.marks(task.marks),
        views=Views(*(_camera(each, frame) for each in task.views)),
        variant=None,
    )
    if not frame.mirrored:
        return changed
    return replace(
        changed,
        goal=goal_for_other_arm(task.goal),
        pose=Pose(
            frame.transform_joint_angles(task.pose.rest_rad), frame.exchange_joint_sides(task.pose.spread_rad)
        ),
        offered=_OTHER_PART.get(task.offered, task.offered),
        tracked=tuple(_OTHER_SIDE.get(part, part) for part in task.tracked),
        strength_share=_other_side(task.strength_share),
    )


def goal_for_other_arm(goal: str) -> str:
    """Returns the goal of a task with the words ``left arm`` and ``right arm`` exchanged."""
    for side, other in (("right", "left"), ("left", "right")):
        if f"{side} arm" in goal:
            return goal.replace(f"{side} arm", f"{other} arm")
    return goal


def _other_side(strength_share: float | Mapping[str, float] | None) -> float | Mapping[str, float] | None:
    if not isinstance(strength_share, Mapping):
        return strength_share
    return {opposite_side_name(name): share for name, share in strength_share.items()}


def state_in_frame(state: State, frame: TaskFrame, mirror_axis: int) -> State:
    """Returns a state, converted from the world frame to the task's frame."""
    if not (frame.mirrored or frame.rise_m):
        return state
    changed: dict[str, Any] = {name: frame.transform_points(getattr(state, name)) for name in _POINTS}
    changed |= {name: frame.transform_vectors(getattr(state, name)) for name in _VECTORS}
    changed["placed_pos_w"] = {name: frame.transform_points(pos) for name, pos in state.placed_pos_w.items()}
    changed["person_segment_w"] = frame.transform_points(state.person_segment_w)
    changed |= vars(_arms(state, frame))
    if frame.mirrored:
        geoms = constant_like(OPPOSITE_GEOM_INDICES, state.person_radius_m)
        changed["person_segment_w"] = changed["person_segment_w"][:, geoms]
        changed["person_radius_m"] = state.person_radius_m[:, geoms]
        changed["head_q_w"] = frame.transform_rotations(state.head_q_w, X_AXIS_INDEX)
        changed["tool_q_w"] = frame.transform_rotations(state.tool_q_w, mirror_axis)
        changed["pad_q_w"] = frame.transform_rotations(state.pad_q_w, mirror_axis)
        changed["base_displacement"] = _base_displacement(state.base_displacement, frame)
    return replace(state, **changed)


def _arms(arms: ArmPoses, frame: TaskFrame) -> ArmPoses:
    pos_w = [frame.transform_points(pos) for pos in (arms.right_arm_pos_w, arms.left_arm_pos_w)]
    q_w = [frame.transform_rotations(q, X_AXIS_INDEX) for q in (arms.right_arm_q_w, arms.left_arm_q_w)]
    right, left = (1, 0) if frame.mirrored else (0, 1)
    return ArmPoses(pos_w[right], q_w[right], pos_w[left], q_w[left])


def _base_displacement(displacement: FloatArray, frame: TaskFrame) -> FloatArray:
    if not (frame.mirrored and displacement.shape[-1]):
        return displacement
    return displacement * constant_like(_BASE_SIGNS, displacement)


@dataclass(eq=False)
class _Wrapped:
    """The functions of a task, with arguments and results in the world frame.

    The converted state is cached: several functions use the same state.
    """

    task: Task
    frame: TaskFrame
    mirror_axis: int
    _latest: tuple[State, State] | None = None

    def state(self, state: State) -> State:
        """Returns the state in the task's frame."""
        latest = self._latest
        if latest is None or latest[0] is not state:
            latest = self._latest = state, state_in_frame(state, self.frame, self.mirror_axis)
        return latest[1]

    def start(self, scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
        frame = self.frame
        found = self.task.start(scene.in_task_frame, frame.transform_people(people), uniforms)
        return replace(
            found,
            people=people,
            robot_pos_w=frame.transform_points(found.robot_pos_w, to_world=True),
            robot_q_w=frame.transform_rotations(found.robot_q_w, Y_AXIS_INDEX),
            placed_pos_w={
                name: frame.transform_points(pos, to_world=True) for name, pos in found.placed_pos_w.items()
            },
        )

    def init_state(self, people: People, uniforms: FloatArray) -> TaskState:
        return self.task.init_state(self.frame.transform_people(people), uniforms)

    def observation(self, scene: SceneConfig) -> Observation:
        entries = self.task.observation(scene.in_task_frame).entries
        return Observation(
            tuple(replace(entry, compute=partial(self._compute, entry.compute)) for entry in entries)
        )

    def _compute(self, compute: EntryFunction, state: State, task_state: TaskState) -> FloatArray:
        return compute(self.state(state), task_state)

    def evaluate_step(self, state: State, action: FloatArray, task_state: TaskState) -> StepResult:
        return self.task.evaluate_step(self.state(state), action, task_state)

    def detour(
        self, detour_m: Callable[[State, TaskState], FloatArray], state: State, task_state: TaskState
    ) -> FloatArray:
        return detour_m(self.state(state), task_state)

    def marks(self, marks: Marks) -> Marks:
        def places(arms: ArmPoses, task_state: TaskState) -> FloatArray:
            return self.frame.transform_points(
                marks.places(_arms(arms, self.frame), task_state), to_world=True
            )

        return replace(marks, places=places)

    def control(self, expert: Expert, episodes: RunningEpisodes) -> Controller:
        controller = expert(_EpisodesInFrame(episodes, self))
        if not self.frame.mirrored or episodes.scene.robot.drive is None:
            return controller
        turn = np.ones(len(episodes.scene.action_names))
        turn[-1] = -1.0
        return lambda observation: controller(observation) * turn


def _camera(view: View, frame: TaskFrame) -> View:
    x, y, z = view.look_at_w
    if frame.mirrored:
        x = -x
    return view._replace(
        look_at_w=(x, y, z + frame.rise_m),
        azimuth_deg=180.0 - view.azimuth_deg if frame.mirrored else view.azimuth_deg,
    )


class _SimulationInFrame:
    """The part of ``Simulation`` that experts use, converted to the task's frame."""

    def __init__(self, simulation: Simulation, frame: TaskFrame) -> None:
        self._simulation, self._frame = simulation, frame
        self.num_worlds = simulation.num_worlds
        self.joint_positions, self.joint_targets = simulation.joint_positions, simulation.joint_targets

    def initial_base_pose(self) -> tuple[FloatArray, FloatArray]:
        return self._base(*self._simulation.initial_base_pose())

    def base_pose(self) -> tuple[FloatArray, FloatArray]:
        return self._base(*self._simulation.base_pose())

    def _base(self, pos_w: FloatArray, q_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._frame.transform_points(pos_w), self._frame.transform_rotations(q_w, Y_AXIS_INDEX)

    def base_displacement(self) -> FloatArray:
        return _base_displacement(self._simulation.base_displacement(), self._frame)


class _EpisodesInFrame:
    """Running episodes with states and simulation in the task's frame, for experts."""

    def __init__(self, episodes: RunningEpisodes, wrapped: _Wrapped) -> None:
        self._episodes, self._wrapped = episodes, wrapped
        self.simulation = cast(Simulation, _SimulationInFrame(episodes.simulation, wrapped.frame))
        self.scene = episodes.scene.in_task_frame

    @property
    def task_state(self) -> TaskState:
        return self._episodes.task_state

    def state(self) -> State:
        return self._wrapped.state(self._episodes.state())
