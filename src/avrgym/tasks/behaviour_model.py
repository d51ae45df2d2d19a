"""Behaviour model of N people: computes their joint targets. People are still, have tremor, cooperate, or behave like
partners of the zoo."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.geometry.arrays import moved_to, namespace
from avrgym.models.human import People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import cooperation
from avrgym.people.cooperation import CooperationState, OfferedPart, PersonObservation
from avrgym.people.distributions import Distribution
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partner_behaviour import JointLimiter, PartnerState
from avrgym.tasks.task import replace_worlds


class BehaviourModel:
    """Computes the joint targets of N people of one distribution, each in an independent episode."""

    def __init__(
        self,
        distribution: Distribution,
        people: People,
        offered: OfferedPart,
        posture: Posture,
        *,
        human_actions: bool,
        exemplar: Any = None,
    ) -> None:
        """Start with the initial state of these people.

        Args:
            distribution: describes how people behave.
            people: their bodies.
            offered: body part that people bring to the tool.
            posture: sitting or reclined.
            human_actions: whether only actions move people, see ``move_targets``.
            exemplar: an array on the device of the state, if it differs from the device of ``people``.
        """
        self._partners = None if human_actions else distribution.partners
        self._cooperating = distribution.cooperating and not human_actions
        self._offered: OfferedPart = offered
        self._posture = posture
        height = people.torso_height_m
        uniforms = namespace(height).zeros(
            (len(height), cooperation.NUM_UNIFORMS), dtype=height.dtype, device=height.device
        )
        self._state = moved_to(self._initial(people, uniforms), height if exemplar is None else exemplar)

    def saved(self) -> CooperationState | PartnerState:
        """Returns the whole state on which the next steps depend."""
        return self._state

    def restore(self, saved: CooperationState | PartnerState) -> None:
        """Restores a state from ``saved``."""
        self._state = saved

    def reset(self, ids: IntArray, people: People, uniforms: FloatArray) -> None:
        """Start episodes of people in worlds ``ids`` (n,), from uniform numbers (n, ``cooperation.NUM_UNIFORMS``)."""
        self._state = replace_worlds(self._state, self._initial(people, uniforms), ids)

    def _initial(self, people: People, uniforms: FloatArray) -> CooperationState | PartnerState:
        if self._partners is None:
            return cooperation.initial_state(people, uniforms)
        return partner_behaviour.initial_state(people, self._partners.draw(uniforms[:, :2]), uniforms[:, 2:])

    def move_targets(self, joints: Sequence[str], action: FloatArray, limit: JointLimiter) -> None:
        """Move the targets of the joints ``joints`` for one control step. Actions (N, K) are speeds, divided by the
        speeds of unhurried people."""
        targets = partner_behaviour.steer_targets(self._state.targets_rad, joints, action)
        self._state = replace(self._state, targets_rad=limit(targets))

    def step(
        self,
        observe: Callable[[], PersonObservation],
        people: People,
        limit: JointLimiter,
        which: BoolArray | None = None,
    ) -> FloatArray:
        """Take a step of 0.1 s; returns the joint targets (N, 20) at its end.

        Tremor changes its direction at every step (reference).

        Args:
            observe: returns the observation of the people; called only for people who react to it.
            people: their bodies.
            limit: limits joint angles to the people's ranges.
            which: mask (N,) of the worlds that take the step; ``None``: all. The returned targets of other worlds have
                no meaning.
        """
        state = self._state
        if isinstance(state, PartnerState):
            state = partner_behaviour.step(state, observe(), self._offered, self._posture, limit)
            onset = partner_behaviour.onset_share(state)[:, None]
            tremor = _tremor_direction(state.time_s) * onset * people.tremor_rad
            targets = state.targets_rad + partner_behaviour.oscillation_rad(state) + tremor
        else:
            state = cooperation.advance_time(state)
            targets = state.targets_rad + _tremor_direction(state.time_s) * people.tremor_rad
            if self._cooperating:
                state = cooperation.update_targets(state, observe(), self._offered, self._posture)
                targets = targets + cooperation.sway_rad(state)
        if which is None:
            self._state = state
        else:
            rows = np.nonzero(which)[0]
            taken = type(state)(**{name: array[rows] for name, array in vars(state).items()})
            self._state = replace_worlds(self._state, taken, rows)
        return limit(targets)


def _tremor_direction(time_s: FloatArray) -> FloatArray:
    """The sign (N, 1) of the tremor. It alternates between −1 and 1 from step to step."""
    odd = namespace(time_s).round(time_s / CONTROL_STEP_S) % 2
    return (2.0 * odd - 1.0)[:, None]
