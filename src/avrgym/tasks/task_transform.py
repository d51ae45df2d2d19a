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
    exchange_side_in_name,
)
from avrgym.people.cooperation import OfferedBodyPart
from avrgym.people.distributions import PoseDistribution
from avrgym.simulation.state import ArmPoses
from avrgym.simulation.worlds import InitialState, Simulation, State
from avrgym.tasks.observation import EntryFunction, ObservationSpec
from avrgym.tasks.task import (
    CameraView,
    CameraViews,
    Controller,
    Expert,
    Markers,
    RunningEpisodes,
    StepResult,
    Task,
    TaskState,
)

_OTHER_SIDE: dict[TrackedBodyPart, TrackedBodyPart] = {"right": "left", "left": "right"}
_OTHER_PART: dict[OfferedBodyPart, OfferedBodyPart] = {"arm": "left_arm", "left_arm": "arm"}
_POINTS = (
    "robot_torso_pos_w", "tool_pos_w", "tool_pad_pos_w", "head_pos_w", "mouth_pos_w", "particle_pos_w", "cloth_pos_w",
    "tool_contact_pos_w",
)  # fmt: skip
_VECTORS = ("end_effector_velocity_w", "tool_velocity_w", "particle_velocity_w", "tool_contact_normal_w")
_BASE_SIGNS = np.array([1.0, -1.0, -1.0])
"""Factors of the displacement of a driving base in a mirrored world: x, y and yaw."""


def transform_task(task: Task, frame: TaskFrame, mirror_axis: int) -> Task:
    """Returns a task for scenes in the world frame, with functions that compute in the task's frame ``frame``.

    ``mirror_axis`` is the axis of the tool's frame that is normal to the tool's plane of symmetry.
    """
    wrapped = _Wrapped(task, frame, mirror_axis)
    changed = replace(
        task,
        sample_initial_states=wrapped.start,
        make_initial_task_state=wrapped.init_state,
        make_observation_spec=wrapped.observation,
        evaluate_step=wrapped.evaluate_step,
        expert=partial(wrapped.control, task.expert),
        feedback_expert=partial(wrapped.control, task.feedback_expert),
        memory_expert=None if task.memory_expert is None else partial(wrapped.control, task.memory_expert),
        compute_detour_m=None
        if task.compute_detour_m is None
        else partial(wrapped.detour, task.compute_detour_m),
        markers=None if task.markers is None else wrapped.marks(task.markers),
        camera_views=CameraViews(*(_camera(each, frame) for each in task.camera_views)),
        make_variant=None,
    )
    if not frame.is_mirrored:
        return changed
    return replace(
        changed,
        goal_description=exchange_arm_in_goal(task.goal_description),
        pose_distribution=PoseDistribution(
            frame.transform_joint_angles(task.pose_distribution.rest_angles_rad),
            frame.exchange_joint_sides(task.pose_distribution.max_offset_rad),
        ),
        offered_body_part=_OTHER_PART.get(task.offered_body_part, task.offered_body_part),
        tracked_body_parts=tuple(_OTHER_SIDE.get(part, part) for part in task.tracked_body_parts),
        strength_share=_other_side(task.strength_share),
    )


def exchange_arm_in_goal(goal: str) -> str:
    """Returns the goal of a task with the words ``left arm`` and ``right arm`` exchanged."""
    for side, other in (("right", "left"), ("left", "right")):
        if f"{side} arm" in goal:
            return goal.replace(f"{side} arm", f"{other} arm")
    return goal


def _other_side(strength_share: float | Mapping[str, float] | None) -> float | Mapping[str, float] | None:
    if not isinstance(strength_share, Mapping):
        return strength_share
    return {exchange_side_in_name(name): share for name, share in strength_share.items()}


def transform_state(state: State, frame: TaskFrame, mirror_axis: int) -> State:
    """Returns a state, converted from the world frame to the task's frame."""
    if not (frame.is_mirrored or frame.height_offset_m):
        return state
    changed: dict[str, Any] = {name: frame.transform_points(getattr(state, name)) for name in _POINTS}
    changed |= {name: frame.transform_vectors(getattr(state, name)) for name in _VECTORS}
    changed["furniture_pos_w"] = {
        name: frame.transform_points(pos) for name, pos in state.furniture_pos_w.items()
    }
    changed["person_capsule_ends_w"] = frame.transform_points(state.person_capsule_ends_w)
    changed |= vars(_arms(state, frame))
    if frame.is_mirrored:
        geoms = constant_like(OPPOSITE_GEOM_INDICES, state.person_radius_m)
        changed["person_capsule_ends_w"] = changed["person_capsule_ends_w"][:, geoms]
        changed["person_radius_m"] = state.person_radius_m[:, geoms]
        changed["head_quat_w"] = frame.transform_rotations(state.head_quat_w, X_AXIS_INDEX)
        changed["tool_quat_w"] = frame.transform_rotations(state.tool_quat_w, mirror_axis)
        changed["tool_pad_quat_w"] = frame.transform_rotations(state.tool_pad_quat_w, mirror_axis)
        changed["base_displacement"] = _base_displacement(state.base_displacement, frame)
    return replace(state, **changed)


def _arms(arms: ArmPoses, frame: TaskFrame) -> ArmPoses:
    pos_w = [frame.transform_points(pos) for pos in (arms.right_arm_pos_w, arms.left_arm_pos_w)]
    q_w = [frame.transform_rotations(q, X_AXIS_INDEX) for q in (arms.right_arm_quat_w, arms.left_arm_quat_w)]
    right, left = (1, 0) if frame.is_mirrored else (0, 1)
    return ArmPoses(pos_w[right], q_w[right], pos_w[left], q_w[left])


def _base_displacement(displacement: FloatArray, frame: TaskFrame) -> FloatArray:
    if not (frame.is_mirrored and displacement.shape[-1]):
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
            latest = self._latest = state, transform_state(state, self.frame, self.mirror_axis)
        return latest[1]

    def start(self, scene: SceneConfig, people: People, uniforms: FloatArray) -> InitialState:
        frame = self.frame
        found = self.task.sample_initial_states(
            scene.scene_in_task_frame, frame.transform_people(people), uniforms
        )
        return replace(
            found,
            people=people,
            robot_base_pos_w=frame.transform_points(found.robot_base_pos_w, to_world=True),
            robot_base_quat_w=frame.transform_rotations(found.robot_base_quat_w, Y_AXIS_INDEX),
            furniture_pos_w={
                name: frame.transform_points(pos, to_world=True)
                for name, pos in found.furniture_pos_w.items()
            },
        )

    def init_state(self, people: People, uniforms: FloatArray) -> TaskState:
        return self.task.make_initial_task_state(self.frame.transform_people(people), uniforms)

    def observation(self, scene: SceneConfig) -> ObservationSpec:
        entries = self.task.make_observation_spec(scene.scene_in_task_frame).entries
        return ObservationSpec(
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

    def marks(self, marks: Markers) -> Markers:
        def places(arms: ArmPoses, task_state: TaskState) -> FloatArray:
            return self.frame.transform_points(
                marks.compute_positions_w(_arms(arms, self.frame), task_state), to_world=True
            )

        return replace(marks, compute_positions_w=places)

    def control(self, expert: Expert, episodes: RunningEpisodes) -> Controller:
        controller = expert(_EpisodesInFrame(episodes, self))
        if not self.frame.is_mirrored or episodes.scene.robot.drive is None:
            return controller
        turn = np.ones(len(episodes.scene.action_names))
        turn[-1] = -1.0
        return lambda observation: controller(observation) * turn


def _camera(view: CameraView, frame: TaskFrame) -> CameraView:
    x, y, z = view.target_pos_w
    if frame.is_mirrored:
        x = -x
    return view._replace(
        target_pos_w=(x, y, z + frame.height_offset_m),
        azimuth_deg=180.0 - view.azimuth_deg if frame.is_mirrored else view.azimuth_deg,
    )


class _SimulationInFrame:
    """The part of ``Simulation`` that experts use, converted to the task's frame."""

    def __init__(self, simulation: Simulation, frame: TaskFrame) -> None:
        self._simulation, self._frame = simulation, frame
        self.num_worlds = simulation.num_worlds
        self.joint_positions, self.joint_targets = (
            simulation.get_joint_positions,
            simulation.get_joint_targets,
        )

    def initial_base_pose(self) -> tuple[FloatArray, FloatArray]:
        return self._base(*self._simulation.get_initial_base_pose())

    def base_pose(self) -> tuple[FloatArray, FloatArray]:
        return self._base(*self._simulation.get_base_pose())

    def _base(self, pos_w: FloatArray, q_w: FloatArray) -> tuple[FloatArray, FloatArray]:
        return self._frame.transform_points(pos_w), self._frame.transform_rotations(q_w, Y_AXIS_INDEX)

    def base_displacement(self) -> FloatArray:
        return _base_displacement(self._simulation.get_base_displacement(), self._frame)


class _EpisodesInFrame:
    """Running episodes with states and simulation in the task's frame, for experts."""

    def __init__(self, episodes: RunningEpisodes, wrapped: _Wrapped) -> None:
        self._episodes, self._wrapped = episodes, wrapped
        self.simulation = cast(Simulation, _SimulationInFrame(episodes.simulation, wrapped.frame))
        self.scene = episodes.scene.scene_in_task_frame

    @property
    def task_state(self) -> TaskState:
        return self._episodes.task_state

    def get_state(self) -> State:
        return self._wrapped.state(self._episodes.get_state())
