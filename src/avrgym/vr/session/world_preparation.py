"""Builds the world of a trial in advance. The real-time thread therefore does not wait until a model is compiled."""

from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import ParamSpec, Self, TypeVar

from avrgym.models.body_names import Sex, Side
from avrgym.models.human import Person
from avrgym.tasks.settings import Settings
from avrgym.vr.live_world.world import LiveWorld

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True)
class BodyKey:
    """Identifies the appearance of a person, independent of the pose."""

    sex: Sex
    torso_height_m: float
    skin_tone: str
    arm_scale: float
    absent_arms: tuple[Side, ...] = ()

    @classmethod
    def from_person(cls, person: Person) -> Self:
        """Returns the key of the person's appearance."""
        return cls(person.sex, person.torso_height_m, person.skin_tone, person.arm_scale, person.absent_arms)


@dataclass(frozen=True)
class WorldKey:
    """Identifies a world by the index of its trial and the person's body."""

    trial_index: int
    body_key: BodyKey


class ImmediateExecutor(Executor):
    """An executor that runs a task within ``submit``, for sessions in simulated time."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class WorldPreparation:
    """Builds one world in advance. ``world_key`` identifies this world; ``None`` if no world was requested."""

    def __init__(self, workers: Executor) -> None:
        self.world_key: WorldKey | None = None
        self._workers = workers
        self._world: Future[LiveWorld] | None = None

    def start(self, key: WorldKey, environment: str, person: Person, settings: Settings, seed: int) -> None:
        """Start to build a world that contains ``person`` in their current pose. Cancels an earlier request."""
        if self._world is not None:
            self._world.cancel()
        self.world_key = key
        self._world = self._workers.submit(_build, environment, person, settings, seed)

    @property
    def is_ready(self) -> bool:
        """Whether the requested world is built, and ``pop_world`` does not wait."""
        return self._world is not None and self._world.done()

    def pop_world(self) -> LiveWorld:
        """Returns the requested world. If building the world raised an error, raises this error."""
        assert self._world is not None
        world, self._world, self.world_key = self._world, None, None
        return world.result()


def _build(environment: str, person: Person, settings: Settings, seed: int) -> LiveWorld:
    world = LiveWorld(environment, person, settings)
    world.reset(seed)
    return world
