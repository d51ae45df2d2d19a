"""The control loop steps N worlds. Environments, training, evaluation, live sessions and replay use it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import gcd
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.commands.preferences import TrialRules
from avrgym.commands.vocabulary import CommandName
from avrgym.models.scene import DEFAULT_SUBSTEPS
from avrgym.safety.force_guard import INTERVENTION_FORCE_LIMIT_FRACTION, ForceGuard
from avrgym.safety.pacing import NO_COMMAND_INPUT, PacingLayer
from avrgym.safety.region_forces import RegionLoadRecorder
from avrgym.safety.withdrawal import Withdrawal

if TYPE_CHECKING:
    from avrgym.tasks.episodes import Episodes


@dataclass(frozen=True, kw_only=True)
class StepOutcome:
    """The result of one control step in N worlds. The first axis is the world.

    Arrays are NumPy arrays in double precision. On a device they are tensors in single precision.

    ``num_events`` (N,) is the number of events, such as bites, in the step. ``executed_action`` (N, A) is the action
    at the end of the step. ``overridden_mask`` (N,) is the mask of worlds in which a layer (force guard, withdrawal or
    pacing) replaced the commanded action. ``guard_interventions`` (N,) is the number of interventions of the guard in
    the episode. Both are ``None`` without such a layer.
    """

    observation: FloatArray
    reward: FloatArray
    reward_terms: Mapping[str, FloatArray]
    success: BoolArray
    distance_m: FloatArray
    force_on_person_n: FloatArray
    tool_speed_m_s: FloatArray
    num_events: IntArray
    executed_action: FloatArray
    overridden_mask: BoolArray | None = None
    guard_interventions: IntArray | None = None


@dataclass(frozen=True)
class FirstWorldStep:
    """A control step of the first world, composed of ticks of 10 ms.

    ``observation`` (O,) is from the start of the step, ``action`` (A,) from its end. ``is_withdrawing`` is true if the
    withdrawal controlled the robot.
    """

    observation: FloatArray
    action: FloatArray
    outcome: StepOutcome
    is_withdrawing: bool


class ActionSource(Protocol):
    """Source of actions for the ticks of a control step: a policy, an operator or a recording."""

    def act(self, observation: FloatArray) -> FloatArray:
        """Returns the actions (N, A) at the start of a control step, given observations (N, O)."""
        ...

    def update_action(self) -> FloatArray | None:
        """Returns new actions (N, A) at a later tick of the control step. ``None``: the current actions continue."""
        ...


class ControlLoop:
    """Steps N worlds: a whole control step with ``step``, or one tick of 10 ms with ``tick``.

    Three layers may replace commanded actions, in this order: ``pacing``, ``withdrawal`` after success, then ``guard``.
    Without guard and recorder, ``step`` runs all physics steps between two actions in one call.
    """

    def __init__(
        self,
        episodes: "Episodes",
        *,
        force_guard: bool = False,
        withdraw_after_success: bool = False,
        reward_withdrawal: bool = False,
        rules: TrialRules | None = None,
    ) -> None:
        """Create the loop with the selected layers.

        Args:
            episodes: episodes in the worlds to step.
            force_guard: whether a force guard overrides actions; needs forces by body region.
            withdraw_after_success: whether robots withdraw after success, see ``Task.withdraws_tool_after_success``.
            reward_withdrawal: whether steps that the withdrawal controls are rewarded.
            rules: the allowed commands and the preferences of participants. ``None``: no pacing layer.
        """
        self._episodes, self._simulation = episodes, episodes.simulation
        withdraws = withdraw_after_success and episodes.task.withdraws_tool_after_success
        self.withdrawal = Withdrawal(self._simulation) if withdraws else None
        share = INTERVENTION_FORCE_LIMIT_FRACTION if rules is None else rules.preferences.force_share
        self.guard = ForceGuard(self._simulation, share) if force_guard else None
        self.pacing = (
            None if rules is None else PacingLayer(self._simulation, episodes.task.offered_body_part, rules)
        )
        self._reward_withdrawal = reward_withdrawal
        self._zeros = np.zeros((self._simulation.num_worlds, episodes.action_size))
        self._commanded: Any = self._zeros
        self._executed: Any = self._zeros
        self._substep, self._was_held = 0, False
        self._substeps = episodes.scene.substeps
        self._observation: FloatArray | None = None
        """Observations (N, O) of the current state directly after a control step, otherwise ``None``."""
        self._first_observation = np.zeros((self._simulation.num_worlds, episodes.observation_spec.size))
        self.applied_action: FloatArray | None = None
        """The action (J,) of the first world if it changed at the latest tick, otherwise ``None``."""
        self.is_braked = False
        """Whether the latest action is zero and the brakes hold the robots."""

    def reset(self, ids: IntArray) -> None:
        """Resets the layers of the worlds ``ids`` (n,), in which episodes start."""
        for layer in (self.pacing, self.withdrawal, self.guard):
            if layer is not None:
                layer.reset(ids)
        self.abort_step()

    def snapshot(self) -> dict[str, Any]:
        """Returns the state of the layers on which the next control step depends."""
        layers = {"pacing": self.pacing, "withdrawal": self.withdrawal, "guard": self.guard}
        return {name: layer.snapshot() for name, layer in layers.items() if layer is not None}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state of the layers from the result of ``snapshot``."""
        if self.pacing is not None:
            self.pacing.restore(snapshot["pacing"])
        if self.withdrawal is not None:
            self.withdrawal.restore(snapshot["withdrawal"])
        if self.guard is not None:
            self.guard.restore(snapshot["guard"])

    @property
    def withdrawing_mask(self) -> BoolArray:
        """Boolean mask (N,): worlds in which the robot withdraws after success, or waits after the withdrawal."""
        if self.withdrawal is None:
            return np.zeros(self._simulation.num_worlds, dtype=bool)
        return self.withdrawal.active_mask

    def apply_command(self, command: CommandName, worlds: BoolArray | None = None) -> BoolArray:
        """Apply a participant's command in the worlds of a mask (N,), by default in all worlds.

        Returns the mask of worlds in which the command has an effect. Without a pacing layer the command has no effect.
        """
        everywhere = np.ones(self._simulation.num_worlds, dtype=bool)
        if self.pacing is None:
            return ~everywhere
        worlds = everywhere if worlds is None else worlds
        effective = self.pacing.apply_command(command, worlds)
        if command == "again" and self.withdrawal is not None and self.pacing.trial_rules.pacing:
            effective = effective | (worlds & self.withdrawal.active_mask)
            self.withdrawal.interrupt(worlds)
        return effective

    def make_command_input(self) -> FloatArray:
        """Returns the commands (N, C) as inputs of controllers, see ``safety.pacing.COMMAND_INPUT_ENTRIES``."""
        if self.pacing is None:
            return np.tile(NO_COMMAND_INPUT, (self._simulation.num_worlds, 1))
        return self.pacing.make_command_input()

    def _paced(self, actions: FloatArray) -> FloatArray:
        """Returns actions (N, A), changed by the pacing layer after partners' commands. Call it once per step."""
        if self.pacing is None:
            return actions
        for command, worlds in self._episodes.generate_partner_commands(
            self.pacing.waiting_mask, self.pacing.speed_factor
        ):
            self.apply_command(command, worlds)
        return self.pacing.override(actions)

    def apply_withdrawal(self, actions: FloatArray) -> FloatArray:
        """Returns the actions (N, A). The withdrawal replaces the actions of the worlds that it controls."""
        return actions if self.withdrawal is None else self.withdrawal.override(actions)

    def add_interventions(self, outcome: StepOutcome, commanded: FloatArray) -> StepOutcome:
        """Returns the result with ``overridden_mask`` and ``guard_interventions``, given the commanded actions (N,
        A).
        """
        if self.pacing is None and self.withdrawal is None and self.guard is None:
            return outcome
        return replace(
            outcome,
            overridden_mask=(outcome.executed_action != commanded).any(axis=-1),
            guard_interventions=None if self.guard is None else self.guard.num_interventions,
        )

    def step(self, actions: FloatArray, recorder: RegionLoadRecorder | None = None) -> StepOutcome:
        """Take one control step with actions (N, A). Returns its result.

        A recorder stores the forces of each physics step.

        Raises:
            ValueError: for actions that ``Episodes.validate_actions`` rejects. The worlds are then unchanged.
        """
        self._commanded = self._episodes.validate_actions(actions)
        self._execute(self.apply_withdrawal(self._paced(self._commanded)))
        if self.guard is None and recorder is None:
            together = gcd(DEFAULT_SUBSTEPS, self._substeps)
            for substep in range(0, self._substeps, together):
                self._episodes.step_physics(substep, together)
            return self._finish()
        for substep in range(self._substeps):
            if substep > 0:
                self._change(None)
            self._episodes.step_physics(substep, 1)
            if recorder is not None:
                recorder.add_forces(self._simulation.compute_region_force_n())
        return self._finish()

    def _execute(self, actions: FloatArray) -> None:
        """Start a control step with actions (N, A). The guard may override them."""
        self._executed = actions if self.guard is None else self.guard.begin_step(actions)
        self._episodes.command_robots(self._executed)

    def _change(self, actions: FloatArray | None) -> bool:
        """Applies new actions of the source or the guard within a control step. Returns whether the actions have
        changed."""
        if self.guard is not None:
            changed = self.guard.update(actions)
            if changed.any():
                self._simulation.command_robot(self.guard.executed_action, changed)
            self._executed = self.guard.executed_action
            return bool(changed.any())
        if actions is not None:
            self._simulation.command_robot(actions)
            self._executed = actions
        return actions is not None

    def _finish(self) -> StepOutcome:
        """Evaluate the control step that ends now. Returns its observation, reward and other results."""
        unrewarded = (
            None if self._reward_withdrawal or self.withdrawal is None else self.withdrawal.active_mask
        )
        outcome = self._episodes.evaluate_step(self._executed, unrewarded)
        if self.withdrawal is not None:
            self.withdrawal.update(outcome.success, outcome.num_events)
        return self.add_interventions(outcome, self._commanded)

    def tick(self, source: ActionSource | None, *, hold: bool = False) -> FirstWorldStep | None:
        """Advance by 10 ms. Returns the completed control step after its last tick, otherwise ``None``.

        Without a source, no control step is in progress. With ``hold``, the brakes hold the robots, and the commanded
        actions are not executed. Interventions of the guard still move the robots. While the withdrawal controls all
        worlds, the source is not called.
        """
        self.applied_action = None
        if source is None:
            self._advance()
            return None
        if self._substep == 0:
            self._begin_ticks(source, hold)
        else:
            self._amend_ticks(source, hold)
        self._was_held = hold
        self._observation = None
        self._episodes.step_physics(self._substep, 1)
        self._substep = (self._substep + 1) % self._substeps
        if self._substep:
            return None
        withdrawing, outcome = bool(self.withdrawing_mask[0]), self._finish()
        self._observation = outcome.observation
        return FirstWorldStep(self._first_observation[0], self._executed[0], outcome, withdrawing)

    def advance_with_action(self, actions: FloatArray | None, *, hold: bool = False) -> None:
        """Advance all worlds by 10 ms outside of control steps. ``actions`` (N, A) replace the current actions, unless
        they are ``None``.
        """
        self.applied_action = None
        if actions is not None:
            self._executed = actions
            self._episodes.command_robots(actions)
            self._note(hold)
        self._advance()

    @property
    def is_moving(self) -> bool:
        """Whether the latest action moves a robot in any world."""
        return bool(self._executed.any())

    def abort_step(self) -> None:
        """Discard an unfinished control step and its actions. The next ``tick`` starts a new control step."""
        self._substep, self._executed = 0, self._zeros
        self.applied_action = self._observation = None

    def _begin_ticks(self, source: ActionSource, hold: bool) -> None:
        self._first_observation = self._episodes.observe() if self._observation is None else self._observation
        if self.withdrawing_mask.all():
            requested = self._zeros
        else:
            requested = self._episodes.validate_actions(source.act(self._first_observation))
        self._commanded = self.apply_withdrawal(self._paced(requested))
        self._execute(self._zeros if hold else self._commanded)
        self._note(hold)

    def _amend_ticks(self, source: ActionSource, hold: bool) -> None:
        requested = None if self.withdrawing_mask.all() else source.update_action()
        if requested is not None:
            checked = self._episodes.validate_actions(requested)
            paced = checked if self.pacing is None else self.pacing.override_within_step(checked)
            self._commanded = self.apply_withdrawal(paced)
        if hold == self._was_held:
            actions = None if hold or requested is None else self._commanded
        else:
            actions = self._zeros if hold else self._commanded
        if self._change(actions) or (hold and not self._was_held):
            self._note(hold)

    def _note(self, hold: bool) -> None:
        self.applied_action = self._executed[0]
        self.is_braked = hold and not self._executed.any()
        if self.is_braked:
            self._simulation.brake_robot()

    def _advance(self) -> None:
        self._observation = None
        self._simulation.step(1)
