"""Commands of simulated participants to the robot, with delays, missed commands and unintended commands."""

from dataclasses import dataclass

import numpy as np

from avrgym.commands.preferences import SPEED_FACTOR_STEP
from avrgym.commands.vocabulary import CommandName, CommandSource, find_allowed_commands
from avrgym.system import random_streams
from avrgym.vr.protocol import messages

PASSIVE_COMMAND_SOURCES: tuple[CommandSource, ...] = ("gaze",)
"""Command sources that need no deliberate action. They detect a command in the participant's usual motion."""
GESTURE_FREQUENCY_HZ, GESTURE_CYCLES, GESTURE_RANGE_DEG = 1.8, 2, 12.0
"""Assumptions about a nod or shake of a simulated participant: frequency, number of cycles, and range of motion."""
GESTURE_DURATION_S = GESTURE_CYCLES / GESTURE_FREQUENCY_HZ
"""Duration of a nod or shake in seconds."""


@dataclass(frozen=True)
class CommandTraits:
    """Parameters of a participant's commands. Their ranges are assumptions.

    ``command_delay_s``: time from the start of the robot's wait to the command ``ready``.
    ``missed_command_probability``: probability that a command is not detected. ``false_commands_per_min``: number of
    unintended commands per minute. ``comfortable_speed_factor``: speed factor of the robot at which the participant
    commands no change of speed.
    """

    command_delay_s: float = 1.0
    missed_command_probability: float = 0.0
    false_commands_per_min: float = 0.0
    comfortable_speed_factor: float = 1.0


def sample_command_traits(seed: int) -> CommandTraits:
    """Returns random command traits of a participant, from a seed."""
    random = random_streams.make_participant_command_rng(seed, 0)
    return CommandTraits(
        command_delay_s=float(random.uniform(0.6, 2.5)),
        missed_command_probability=float(random.uniform(0.0, 0.15)),
        false_commands_per_min=float(random.uniform(0.0, 1.0)),
        comfortable_speed_factor=float(random.uniform(0.6, 1.2)),
    )


class SimulatedCommandGenerator:
    """Generates the commands of a simulated participant in trials.

    The participant commands ``ready`` when the robot waits. During each wait of the robot, the participant commands
    ``slower`` or ``faster`` once if the speed is not comfortable. Unintended commands occur at random times, but never
    the command ``stop``.
    """

    def __init__(self, traits: CommandTraits, seed: int) -> None:
        """Start a trial. ``seed``: seed of the trial, for delays and unintended commands."""
        self._traits = traits
        self._random = random_streams.make_participant_command_rng(seed, 1)
        self._offered: messages.AvailableRobotCommands | None = None
        self._planned: list[tuple[float, CommandName]] = []
        self._next_false_s = np.inf

    def receive(self, offered: messages.AvailableRobotCommands, now_s: float) -> None:
        """Handle a message with the allowed commands and the robot's mode."""
        before, self._offered = self._offered, offered if offered.commands else None
        if self._offered is None:
            self._planned, self._next_false_s = [], np.inf
            return
        if before is None:
            self._next_false_s = now_s + self._interval_s()
        if before is None or before.mode != offered.mode:
            self._planned = [] if offered.mode != "waiting" else self._on_waiting(offered, now_s)

    def pop_due_command(self, now_s: float) -> tuple[CommandName, CommandSource] | None:
        """Returns the participant's command at this time with its source; ``None`` if there is no command."""
        if self._offered is None:
            return None
        if now_s >= self._next_false_s:
            self._next_false_s = now_s + self._interval_s()
            names: list[CommandName] = [each.name for each in self._offered.commands if each.name != "stop"]
            return self._given(names[int(self._random.integers(len(names)))]) if names else None
        if self._planned and now_s >= self._planned[0][0]:
            _, command = self._planned.pop(0)
            if command == "ready":  # repeated until the robot continues
                self._planned.append((now_s + 2.0 * self._traits.command_delay_s, "ready"))
            return (
                None
                if self._random.random() < self._traits.missed_command_probability
                else self._given(command)
            )
        return None

    def _on_waiting(
        self, offered: messages.AvailableRobotCommands, now_s: float
    ) -> list[tuple[float, CommandName]]:
        delay_s, names = self._traits.command_delay_s, {each.name for each in offered.commands}
        excess = offered.speed_factor - self._traits.comfortable_speed_factor
        pace: CommandName = "slower" if excess > 0.0 else "faster"
        planned: list[tuple[float, CommandName]] = []
        if abs(excess) > 0.5 * SPEED_FACTOR_STEP and pace in names:
            planned.append((now_s + 0.5 * delay_s, pace))
        if "ready" in names:
            planned.append((now_s + delay_s, "ready"))
        return planned

    def _given(self, command: CommandName) -> tuple[CommandName, CommandSource] | None:
        """Returns the command with the first allowed source that can give it; ``None`` if there is no such source."""
        assert self._offered is not None
        for source in self._offered.sources:
            if source not in PASSIVE_COMMAND_SOURCES and command in find_allowed_commands(source):
                return command, source
        return None

    def _interval_s(self) -> float:
        """Returns a random time in seconds until the next unintended command."""
        rate = self._traits.false_commands_per_min
        interval_s = float(self._random.exponential())
        return 60.0 * interval_s / rate if rate else np.inf


def compute_gesture_angles_rad(source: CommandSource, time_s: float) -> tuple[float, float]:
    """Returns pitch and yaw of the head in radians, ``time_s`` after the start of a gesture."""
    if not 0.0 <= time_s <= GESTURE_DURATION_S:
        return 0.0, 0.0
    swing, phase = float(np.radians(GESTURE_RANGE_DEG)), 2.0 * np.pi * GESTURE_FREQUENCY_HZ * time_s
    if source == "nod":
        return 0.5 * swing * (1.0 - float(np.cos(phase))), 0.0
    return 0.0, 0.5 * swing * float(np.sin(phase))
