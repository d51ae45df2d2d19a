"""Commands of simulated participants to the robot, with delays, misses and false commands."""

from dataclasses import dataclass

import numpy as np

from avrgym.commands.preferences import SPEED_STEP
from avrgym.commands.vocabulary import CommandName, Source, commands_of
from avrgym.system import random_streams
from avrgym.vr.protocol import messages

CONTINUOUS_SOURCES: tuple[Source, ...] = ("gaze",)
"""Sources that need no action: the participant's usual motion gives these commands."""
GESTURE_HZ, GESTURE_CYCLES, GESTURE_DEG = 1.8, 2, 12.0
"""A nod or shake of a simulated participant: frequency, number of cycles, and swing. The values are assumptions."""
GESTURE_S = GESTURE_CYCLES / GESTURE_HZ


@dataclass(frozen=True)
class CommandTraits:
    """How a participant gives commands. The ranges are assumptions.

    ``delay_s``: time from an occasion until the command. ``miss``: probability that a command does not arrive.
    ``false_per_min``: commands that the participant did not intend. ``comfortable_speed``: speed factor at which the
    participant asks for no change.
    """

    delay_s: float = 1.0
    miss: float = 0.0
    false_per_min: float = 0.0
    comfortable_speed: float = 1.0


def draw_command_traits(seed: int) -> CommandTraits:
    """Returns the traits of a participant with this seed."""
    random = random_streams.participant_command_generator(seed, 0)
    return CommandTraits(
        delay_s=float(random.uniform(0.6, 2.5)),
        miss=float(random.uniform(0.0, 0.15)),
        false_per_min=float(random.uniform(0.0, 1.0)),
        comfortable_speed=float(random.uniform(0.6, 1.2)),
    )


class SimulatedCommands:
    """Gives commands in the trials of a simulated participant.

    The participant says ``ready`` when the robot waits, asks for another speed once per wait until the speed is
    comfortable, and sometimes gives a command that they did not intend, except ``stop``.
    """

    def __init__(self, traits: CommandTraits, seed: int) -> None:
        """Start with the random stream of a trial's ``seed``."""
        self._traits = traits
        self._random = random_streams.participant_command_generator(seed, 1)
        self._offered: messages.RobotCommands | None = None
        self._planned: list[tuple[float, CommandName]] = []
        self._next_false_s = np.inf

    def watch(self, offered: messages.RobotCommands, now_s: float) -> None:
        """Handle a change of the possible commands or of what the robot does."""
        before, self._offered = self._offered, offered if offered.commands else None
        if self._offered is None:
            self._planned, self._next_false_s = [], np.inf
            return
        if before is None:
            self._next_false_s = now_s + self._interval_s()
        if before is None or before.mode != offered.mode:
            self._planned = [] if offered.mode != "waiting" else self._on_waiting(offered, now_s)

    def due(self, now_s: float) -> tuple[CommandName, Source] | None:
        """Returns a command that the participant gives now, and its source; ``None`` without one."""
        if self._offered is None:
            return None
        if now_s >= self._next_false_s:
            self._next_false_s = now_s + self._interval_s()
            names: list[CommandName] = [each.name for each in self._offered.commands if each.name != "stop"]
            return self._given(names[int(self._random.integers(len(names)))]) if names else None
        if self._planned and now_s >= self._planned[0][0]:
            _, command = self._planned.pop(0)
            if command == "ready":  # repeated until the robot continues
                self._planned.append((now_s + 2.0 * self._traits.delay_s, "ready"))
            return None if self._random.random() < self._traits.miss else self._given(command)
        return None

    def _on_waiting(self, offered: messages.RobotCommands, now_s: float) -> list[tuple[float, CommandName]]:
        delay_s, names = self._traits.delay_s, {each.name for each in offered.commands}
        excess = offered.speed_factor - self._traits.comfortable_speed
        pace: CommandName = "slower" if excess > 0.0 else "faster"
        planned: list[tuple[float, CommandName]] = []
        if abs(excess) > 0.5 * SPEED_STEP and pace in names:
            planned.append((now_s + 0.5 * delay_s, pace))
        if "ready" in names:
            planned.append((now_s + delay_s, "ready"))
        return planned

    def _given(self, command: CommandName) -> tuple[CommandName, Source] | None:
        """Returns the command with the first allowed source that can give it."""
        assert self._offered is not None
        for source in self._offered.sources:
            if source not in CONTINUOUS_SOURCES and command in commands_of(source):
                return command, source
        return None

    def _interval_s(self) -> float:
        """Returns the time until the next command that is not intended."""
        rate = self._traits.false_per_min
        interval_s = float(self._random.exponential())
        return 60.0 * interval_s / rate if rate else np.inf


def gesture_angles(source: Source, time_s: float) -> tuple[float, float]:
    """Returns the pitch and yaw of the head in a gesture, this time after its start."""
    if not 0.0 <= time_s <= GESTURE_S:
        return 0.0, 0.0
    swing, phase = float(np.radians(GESTURE_DEG)), 2.0 * np.pi * GESTURE_HZ * time_s
    if source == "nod":
        return 0.5 * swing * (1.0 - float(np.cos(phase))), 0.0
    return 0.0, 0.5 * swing * float(np.sin(phase))
