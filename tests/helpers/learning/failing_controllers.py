"""Controllers that fail, each in its own way; every one drives first."""

import time
from typing import ClassVar

import numpy as np


class Steady:
    """Turns the first joint at half its speed."""

    closed = 0

    def reset(self, seed: int, environment: str) -> None:
        self.seed, self.environment, self.steps = seed, environment, 0

    def act(self, observation: np.ndarray) -> object:
        self.steps += 1
        observation[:] = np.nan  # what it is given is its own
        return self.bad() if self.steps in (2, 3) else [0.5, 0, 0, 0, 0, 0, 0]

    def bad(self) -> object:
        return [0.5, 0, 0, 0, 0, 0, 0]

    def close(self) -> None:
        type(self).closed += 1


class NotFinite(Steady):
    def bad(self) -> object:
        return [np.nan] * 7


class Infinite(Steady):
    def bad(self) -> object:
        return [np.inf] + [0.0] * 6


class WrongShape(Steady):
    def bad(self) -> object:
        return np.zeros((1, 7))


class TooFew(Steady):
    def bad(self) -> object:
        return [0.0] * 6


class Words(Steady):
    def bad(self) -> object:
        return "left"


class Nothing(Steady):
    def bad(self) -> object:
        return None


class Raises(Steady):
    def bad(self) -> object:
        raise KeyError("no \x00 \ud800 such thing" * 100)


class RaisesAtReset(Steady):
    def reset(self, seed: int, environment: str) -> None:
        raise RuntimeError("not today")


class Slow(Steady):
    def bad(self) -> object:
        time.sleep(0.25)
        return [-0.5, 0, 0, 0, 0, 0, 0]


class Hangs(Steady):
    made: ClassVar[list["Hangs"]] = []

    def __init__(self) -> None:
        self.made.append(self)

    def bad(self) -> object:
        time.sleep(3600)
        return None


class LeavesAtOnce(Steady):
    def bad(self) -> object:
        raise SystemExit


class Noisy(Steady):
    """Acts at random, from its seed alone."""

    def reset(self, seed: int, environment: str) -> None:
        self.rng = np.random.default_rng(seed)

    def act(self, observation: np.ndarray) -> object:
        return 3.0 * self.rng.normal(size=7)


class WithoutReset:
    def act(self, observation: np.ndarray) -> object:
        return np.zeros(7)


def unmakeable() -> Steady:
    """Needs something that is not there."""
    raise FileNotFoundError("weights.bin")


READY = Noisy()
