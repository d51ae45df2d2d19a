"""Behaviour model of N people: computes their joint targets.

People hold still, have tremor, cooperate with the robot, or behave like partners of the zoo. ``people.motor_model``
moves their joints.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.arrays import get_namespace, to_device_of
from avrgym.models.human import People, Posture
from avrgym.people import cooperation, motion_version_1, motor_model
from avrgym.people.cooperation import CooperationState, OfferedBodyPart, PersonObservation
from avrgym.people.distributions import PeopleDistribution
from avrgym.people.motor_model import MotorState
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partner_behaviour import JointLimiter, PartnerState
from avrgym.tasks.task import get_task_state_arrays, replace_task_states

BehaviourState = CooperationState | PartnerState


class BehaviourModel:
    """Computes the joint targets of N people of one distribution, each in an independent episode.

    With ``people.motor_model``, call ``choose_goal_angles`` every 0.1 s. Between these calls, ``advance_joint_targets``
    returns the targets. With version 1 of the motion model, call ``step`` every 0.1 s.
    """

    def __init__(
        self,
        distribution: PeopleDistribution,
        people: People,
        offered: OfferedBodyPart,
        posture: Posture,
        *,
        human_actions: bool,
        example_array: Any = None,
    ) -> None:
        """Create the behaviour model in the initial state of ``people``.

        Args:
            distribution: distribution of the people, which determines how they behave.
            people: their body parameters.
            offered: body part that people bring to the tool.
            posture: posture of the people, seated or reclined.
            human_actions: whether only actions move people, see ``move_joint_targets``.
            example_array: an array on the device of the state, if it differs from the device of ``people``.
        """
        self._partners = None if human_actions else distribution.partners
        self._cooperating = distribution.is_cooperating and not human_actions
        self._offered: OfferedBodyPart = offered
        self._posture = posture
        height = people.torso_height_m
        self._exemplar = height if example_array is None else example_array
        uniforms = get_namespace(height).zeros(
            (len(height), cooperation.NUM_RANDOM_NUMBERS), dtype=height.dtype, device=height.device
        )
        self._state, self._motor = self._initial(people, uniforms)

    def snapshot(self) -> tuple[BehaviourState, MotorState]:
        """Returns the states of behaviour model and motor model, on which the next steps depend."""
        return self._state, self._motor

    def restore(self, snapshot: tuple[BehaviourState, MotorState]) -> None:
        """Restore both states from the result of ``snapshot``."""
        self._state, self._motor = snapshot

    def reset(self, ids: IntArray, people: People, uniforms: FloatArray) -> None:
        """Start episodes in worlds ``ids`` (n,) with the bodies ``people``.

        Behaviour parameters are sampled from uniform random numbers (n, ``cooperation.NUM_RANDOM_NUMBERS``).
        """
        state, motor_state = self._initial(people, uniforms)
        self._state = replace_task_states(self._state, state, ids)
        self._motor = replace_task_states(self._motor, motor_state, ids)

    def _initial(self, people: People, uniforms: FloatArray) -> tuple[BehaviourState, MotorState]:
        if self._partners is not None:
            state = partner_behaviour.make_initial_state(
                people, self._partners.sample(uniforms[:, :2]), uniforms[:, 2:]
            )
            moved = partner_behaviour.make_initial_motor_state(state, people)
        else:
            state = cooperation.make_initial_state(people, uniforms)
            moved = cooperation.make_initial_motor_state(state, people, uniforms, sways=self._cooperating)
        return to_device_of(state, self._exemplar), to_device_of(moved, self._exemplar)

    def move_joint_targets(self, joints: Sequence[str], action: FloatArray, limit: JointLimiter) -> None:
        """Move the targets of the joints named ``joints`` for one control step.

        Actions (N, K) are joint speeds, divided by ``people.motor_model.MAX_JOINT_SPEED_RAD_S``.
        """
        targets = partner_behaviour.move_joint_targets(self._state.joint_targets_rad, joints, action)
        self._state = replace(self._state, joint_targets_rad=limit(targets))

    def step(
        self,
        observe: Callable[[], PersonObservation],
        people: People,
        limit: JointLimiter,
        world_mask: BoolArray | None = None,
    ) -> FloatArray:
        """Advance the motion of people by 0.1 s, with version 1 of the motion model. Returns the joint targets (N, 20).

        Args:
            observe: returns the people's observation; called only if the people react to the tool.
            people: their body parameters.
            limit: limits joint angles to the people's ranges.
            world_mask: mask (N,) of the worlds to advance; ``None``: all. The targets of other worlds are invalid.
        """
        old, offered, posture = self._state, self._offered, self._posture
        if isinstance(old, PartnerState):
            state, targets = motion_version_1.step_partners(old, people, observe(), offered, posture, limit)
        else:
            observation = observe() if self._cooperating else None
            state, targets = motion_version_1.step_participants(old, people, observation, offered, posture)
        self._state = _chosen(world_mask, state, self._state)
        return limit(targets)

    def choose_goal_angles(
        self,
        observe: Callable[[], PersonObservation],
        limit: JointLimiter,
        world_mask: BoolArray | None = None,
    ) -> None:
        """Chooses the goal joint angles of people for the next 0.1 s. The arguments are those of ``step``."""
        state: BehaviourState = replace(self._state, joint_targets_rad=self._motor.second_filter_angles_rad)
        goals, startled = self._motor.goal_angles_rad, None
        if isinstance(state, PartnerState):
            state, goals = partner_behaviour.choose_goal_angles(
                state, observe(), self._offered, self._posture
            )
            startled = partner_behaviour.are_startled(state)
        elif self._cooperating:
            state, goals = cooperation.choose_goal_angles(
                state, goals, observe(), self._offered, self._posture
            )
        moved = motor_model.set_goal_angles(self._motor, limit(goals), startled)
        self._state, self._motor = (
            _chosen(world_mask, state, self._state),
            _chosen(world_mask, moved, self._motor),
        )

    def advance_joint_targets(self, limit: JointLimiter, count: int) -> FloatArray:
        """Advances the people's motion by ``count`` steps of 10 ms. Returns the joint targets (``count``, N, 20) at the
        end of each step."""
        self._motor, targets = motor_model.advance_joint_targets_rad(self._motor, count)
        return limit(targets)


def _chosen(world_mask: BoolArray | None, new: Any, old: Any) -> Any:
    """Returns the state ``new`` in the worlds of the mask (N,), and ``old`` in the others. With ``None``, returns
    ``new``."""
    if world_mask is None:
        return new
    rows = np.nonzero(world_mask)[0]
    taken = {name: array[rows] for name, array in get_task_state_arrays(new).items()}
    return replace_task_states(old, type(new)(**taken), rows)
