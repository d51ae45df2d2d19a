"""What N people want their joints to do by themselves: hold still, tremble, cooperate, or live as in the zoo."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from avrgym.array_types import FloatArray, IntArray
from avrgym.geometry.arrays import moved_to, namespace
from avrgym.models.human import People, Posture
from avrgym.models.scene import CONTROL_STEP_S
from avrgym.people import cooperation
from avrgym.people.cooperation import OfferedPart, PersonObservation
from avrgym.people.distributions import Distribution
from avrgym.people.zoo import partner_behaviour
from avrgym.people.zoo.partner_behaviour import JointLimiter
from avrgym.tasks.task import replace_worlds


class Minds:
    """The minds of N people of one kind, each with an episode of its own."""

    def __init__(
        self,
        distribution: Distribution,
        people: People,
        offered: OfferedPart,
        posture: Posture,
        *,
        steered: bool,
        beside: Any = None,
    ) -> None:
        """See ``Episodes`` for what is offered and steered; they live where the array ``beside`` is, or the people."""
        self._partners = None if steered else distribution.partners
        self._cooperating = distribution.cooperating and not steered
        self._offered: OfferedPart = offered
        self._posture = posture
        height = people.torso_height_m
        uniforms = namespace(height).zeros(
            (len(height), cooperation.NUM_UNIFORMS), dtype=height.dtype, device=height.device
        )
        self._mind = moved_to(self._begun(people, uniforms), height if beside is None else beside)

    def saved(self) -> cooperation.CooperationState | partner_behaviour.PartnerState:
        """All that changes."""
        return self._mind

    def go_on_from(self, saved: cooperation.CooperationState | partner_behaviour.PartnerState) -> None:
        """Have the minds that ``saved`` gave."""
        self._mind = saved

    def begin(self, ids: IntArray, people: People, uniforms: FloatArray) -> None:
        """Begin episodes of people in worlds ``ids`` (n,), from uniform numbers (n, ``behaviour.NUM_UNIFORMS``)."""
        self._mind = replace_worlds(self._mind, self._begun(people, uniforms), ids)

    def _begun(
        self, people: People, uniforms: FloatArray
    ) -> cooperation.CooperationState | partner_behaviour.PartnerState:
        if self._partners is None:
            return cooperation.initial_state(people, uniforms)
        return partner_behaviour.initial_state(people, self._partners.draw(uniforms[:, :2]), uniforms[:, 2:])

    def steer(self, joints: Sequence[str], action: FloatArray, possible: JointLimiter) -> None:
        """Move the targets of joints by a control step at speeds of unhurried people, shares (N, K) of them."""
        targets = partner_behaviour.steer_targets(self._mind.targets_rad, joints, action)
        self._mind = replace(self._mind, targets_rad=possible(targets))

    def live(
        self, look: Callable[[], PersonObservation], people: People, possible: JointLimiter
    ) -> FloatArray:
        """One control step passes: where their joints (N, 20) are to be at its end.

        Tremor changes its direction at every control step (reference).

        Args:
            look: gives what they see now; only those who look are asked.
            people: their bodies.
            possible: where their joints can go.
        """
        if isinstance(self._mind, partner_behaviour.PartnerState):
            return possible(self._live_in_the_zoo(self._mind, look(), people, possible))
        mind = cooperation.advance_time(self._mind)
        targets = mind.targets_rad + _direction(mind.time_s) * people.tremor_rad
        if self._cooperating:
            mind = cooperation.update_targets(mind, look(), self._offered, self._posture)
            targets = targets + cooperation.sway_rad(mind)
        self._mind = mind
        return possible(targets)

    def _live_in_the_zoo(
        self,
        mind: partner_behaviour.PartnerState,
        sight: PersonObservation,
        people: People,
        possible: JointLimiter,
    ) -> FloatArray:
        mind = partner_behaviour.step(mind, sight, self._offered, self._posture, possible)
        self._mind = mind
        tremor = _direction(mind.time_s) * partner_behaviour.onset_share(mind)[:, None] * people.tremor_rad
        return mind.targets_rad + partner_behaviour.oscillation_rad(mind) + tremor


def _direction(time_s: FloatArray) -> FloatArray:
    """Which way a tremor goes, (N, 1)."""
    odd = namespace(time_s).round(time_s / CONTROL_STEP_S) % 2
    return (2.0 * odd - 1.0)[:, None]
