"""Partners that command the robot: the style ``commanding``. These partners move like those of the style
``cooperating``.

The populations of these partners are ``zoo/train/commanding``, ``zoo/unseen/commanding`` and
``zoo/extreme/commanding``. The other populations do not contain these partners. With them, the robot waits in front of
mouth or arm for a command, see ``safety.pacing``.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from avrgym.array_types import BoolArray, FloatArray, IntArray
from avrgym.commands.preferences import SPEED_FACTOR_STEP, ConditionRules, TrialRules, apply_preferences
from avrgym.commands.vocabulary import CommandName
from avrgym.people.zoo.partners import (
    STYLE_LEVELS,
    PartnerSet,
    interpolate_style_parameters,
    make_behaviour_parameters,
)
from avrgym.people.zoo.styles import COMMAND_PARAMETER_SOURCES, COMMANDING_STYLE, COMMANDING_STYLE_NAME

DEFAULT_COMMAND_RULES: TrialRules = apply_preferences(
    ConditionRules(policy="", commands=("ready", "wait", "slower", "faster", "stop"), sources=("key",)), None
)
"""Default rules of the pacing layer for these partners."""


@dataclass(frozen=True)
class CommandParameters:
    """Parameters of the commands of P partners, arrays (P,).

    Attributes:
        ready_delay_s: time from the start of the robot's wait to the command ``ready``.
        comfortable_speed: speed factor at which the partner commands no change of speed.
        wait_commands_per_min: number of commands ``wait`` per minute, without the time in which the robot waits.
    """

    ready_delay_s: FloatArray
    comfortable_speed: FloatArray
    wait_commands_per_min: FloatArray

    def select_partners(self, rows: IntArray) -> "CommandParameters":
        """Returns the command parameters of the partners with the indices ``rows``, arrays (n,)."""
        return CommandParameters(*(array[rows] for array in vars(self).values()))


@dataclass(frozen=True, eq=False)
class CommandingPartners(PartnerSet):
    """A set of partners that give commands. A row of ``command_parameters`` belongs to the same partner as this row of
    ``parameters``.
    """

    command_parameters: CommandParameters


def _partners_of(zoo: str) -> CommandingPartners:
    values = [
        interpolate_style_parameters(COMMANDING_STYLE, levels)
        for levels in product(*(STYLE_LEVELS[zoo] for _ in COMMANDING_STYLE.axis_ranges))
    ]
    commands = CommandParameters(
        *(np.array([each[name] for each in values]) for name in COMMAND_PARAMETER_SOURCES)
    )
    return CommandingPartners(make_behaviour_parameters(values), ((0, len(values)),), commands)


COMMANDING_PARTNER_SETS: Mapping[str, CommandingPartners] = {
    f"{zoo}/{COMMANDING_STYLE_NAME}": _partners_of(zoo) for zoo in STYLE_LEVELS
}


CommandState = tuple[CommandParameters, FloatArray, FloatArray, FloatArray]


class PartnerCommands:
    """The commands of partners in N worlds. A command is given at the start of a control step.

    The times between commands ``wait`` are equal. The first command ``wait`` is after a random share of this time.
    """

    def __init__(self, partners: CommandingPartners, worlds: int) -> None:
        """Create arrays for N ``worlds`` without partners. ``reset`` samples the partners."""
        self._partners = partners
        self._parameters = partners.command_parameters.select_partners(np.zeros(worlds, dtype=np.intp))
        self._waited_s: FloatArray = np.zeros(worlds)
        self._moved_s: FloatArray = np.zeros(worlds)
        self._phase: FloatArray = np.zeros(worlds)

    def reset(self, ids: IntArray, uniforms: FloatArray) -> None:
        """Start episodes in worlds ``ids`` (n,). ``uniforms`` (n, 3) sample the partners and their first ``wait``."""
        own = self._partners.command_parameters.select_partners(
            self._partners.sample_partner_rows(uniforms[:, :2])
        )
        self._parameters = CommandParameters(
            *(
                _with_rows(array, ids, values)
                for array, values in zip(vars(self._parameters).values(), vars(own).values(), strict=True)
            )
        )
        self._waited_s = _with_rows(self._waited_s, ids, 0.0)
        self._moved_s = _with_rows(self._moved_s, ids, 0.0)
        self._phase = _with_rows(self._phase, ids, uniforms[:, 2])

    def step(
        self, waiting: BoolArray, speed_factor: FloatArray, step_s: float
    ) -> Iterator[tuple[CommandName, BoolArray]]:
        """Yields the commands of this control step, each with a mask (N,) of worlds.

        Args:
            waiting: worlds (N,) in which the robot waits.
            speed_factor: speed factors (N,) of the robots.
            step_s: duration of a control step.
        """
        begins = waiting & (self._waited_s == 0.0)
        excess = speed_factor - self._parameters.comfortable_speed
        yield "slower", begins & (excess > 0.5 * SPEED_FACTOR_STEP)
        yield "faster", begins & (excess < -0.5 * SPEED_FACTOR_STEP)
        self._waited_s = np.where(waiting, self._waited_s + step_s, 0.0)
        yield "ready", waiting & (self._waited_s >= self._parameters.ready_delay_s)
        before = self._wait_count()
        self._moved_s = np.where(waiting, self._moved_s, self._moved_s + step_s)
        yield "wait", self._wait_count() > before

    def _wait_count(self) -> FloatArray:
        """Returns the number of commands ``wait`` until now (N,)."""
        return np.floor(self._moved_s * self._parameters.wait_commands_per_min / 60.0 + self._phase)

    def snapshot(self) -> CommandState:
        """Returns the state of the partners' commands on which the next steps depend."""
        return self._parameters, self._waited_s, self._moved_s, self._phase

    def restore(self, snapshot: CommandState) -> None:
        """Restore a state from ``snapshot``."""
        self._parameters, self._waited_s, self._moved_s, self._phase = snapshot


def _with_rows(array: FloatArray, ids: IntArray, values: FloatArray | float) -> FloatArray:
    """Returns a copy of an array (N,) with new values in the rows ``ids``."""
    changed = array.copy()
    changed[ids] = values
    return changed
