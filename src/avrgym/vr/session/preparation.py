"""Makes the world of a trial ahead of time, so that the real-time thread never waits for a compiler."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import ParamSpec, Self, TypeVar

from avrgym.models.human import Person, Sex
from avrgym.vr.live_world.world import LiveWorld

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class BodyKey:
    """What a person looks like, however they sit."""

    sex: Sex
    torso_height_m: float
    skin_tone: str
    arm_scale: float

    @classmethod
    def of(cls, person: Person) -> Self:
        """That of a person."""
        return cls(person.sex, person.torso_height_m, person.skin_tone, person.arm_scale)


@dataclass(frozen=True)
class TrialKey:
    """Which trial a world is for, and for which body."""

    trial: int
    body: BodyKey


class AtOnce(Executor):
    """Runs what is submitted before it returns: for sessions in simulated time, which must not depend on threads."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Preparation:
    """The world that is being made, if any. ``key`` is whose it is."""

    def __init__(self, workers: Executor) -> None:
        self.key: TrialKey | None = None
        self._workers = workers
        self._world: Future[LiveWorld] | None = None

    def ask(self, key: TrialKey, environment: str, person: Person, seed: int) -> None:
        """Begin to make a world whose person sits or lies as given; what was asked before is forgotten."""
        if self._world is not None:
            self._world.cancel()
        self.key = key
        self._world = self._workers.submit(_make, environment, person, seed)

    @property
    def ready(self) -> bool:
        """Whether ``take`` need not wait."""
        return self._world is not None and self._world.done()

    def take(self) -> LiveWorld:
        """The world that was asked for; raises what kept it from being made."""
        assert self._world is not None
        world, self._world, self.key = self._world, None, None
        return world.result()


def _make(environment: str, person: Person, seed: int) -> LiveWorld:
    world = LiveWorld(environment, person)
    world.reset(seed)
    return world
