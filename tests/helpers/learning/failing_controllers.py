"""Controllers that fail after a valid first action."""

import time
from typing import ClassVar

import numpy as np


class Steady:
    """Moves the first joint at half its maximum speed."""

    closed = 0

    def reset(self, seed: int, environment: str) -> None:
        self.seed, self.environment, self.steps = seed, environment, 0

    def act(self, observation: np.ndarray) -> object:
        self.steps += 1
        observation[:] = np.nan  # the controller owns its copy
        return self.invalid_action() if self.steps in (2, 3) else [0.5, 0, 0, 0, 0, 0, 0]

    def invalid_action(self) -> object:
        return [0.5, 0, 0, 0, 0, 0, 0]

    def close(self) -> None:
        type(self).closed += 1


class NotFinite(Steady):
    def invalid_action(self) -> object:
        return [np.nan] * 7


class Infinite(Steady):
    def invalid_action(self) -> object:
        return [np.inf] + [0.0] * 6


class WrongShape(Steady):
    def invalid_action(self) -> object:
        return np.zeros((1, 7))


class TooFew(Steady):
    def invalid_action(self) -> object:
        return [0.0] * 6


class Words(Steady):
    def invalid_action(self) -> object:
        return "left"


class Nothing(Steady):
    def invalid_action(self) -> object:
        return None


class Raises(Steady):
    def invalid_action(self) -> object:
        raise KeyError("no \x00 \ud800 such thing" * 100)


class RaisesAtReset(Steady):
    def reset(self, seed: int, environment: str) -> None:
        raise RuntimeError("not today")


class Slow(Steady):
    def invalid_action(self) -> object:
        time.sleep(0.25)
        return [-0.5, 0, 0, 0, 0, 0, 0]


class Hangs(Steady):
    made: ClassVar[list["Hangs"]] = []

    def __init__(self) -> None:
        self.made.append(self)

    def invalid_action(self) -> object:
        time.sleep(3600)
        return None


class LeavesAtOnce(Steady):
    def invalid_action(self) -> object:
        raise SystemExit


class Noisy(Steady):
    """Returns random actions from its seed."""

    def reset(self, seed: int, environment: str) -> None:
        self.rng = np.random.default_rng(seed)

    def act(self, observation: np.ndarray) -> object:
        return 3.0 * self.rng.normal(size=7)


class WithoutReset:
    def act(self, observation: np.ndarray) -> object:
        return np.zeros(7)


def unmakeable() -> Steady:
    """Fail because of a missing file."""
    raise FileNotFoundError("weights.bin")


READY = Noisy()
