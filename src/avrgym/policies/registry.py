"""All that ``--policy`` may name, and how it acts in worlds whose episodes have begun."""

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.policies import controllers
from avrgym.policies.actors import Actor
from avrgym.policies.controllers import Foreign
from avrgym.policies.names import FORMS, OPERATOR, SCRIPTS
from avrgym.policies.onnx import ONNX_SUFFIX, find_onnx
from avrgym.policies.trained import Policy, PolicyError, load_policy, packaged_policies
from avrgym.robots.registry import BROKEN as BROKEN_ROBOTS
from avrgym.system.used_plugins import UsedPlugin, differences
from avrgym.tasks.episodes import Episodes
from avrgym.tasks.registry import BROKEN as BROKEN_TASKS
from avrgym.tasks.registry import plugins_of, sizes

Act = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Script:
    """A driver that comes with AVR Gym and is no network: one of ``SCRIPTS``."""

    name: str


@dataclass(frozen=True)
class Operated:
    """The experimenter drives the hand."""


Autonomous = Policy | Script | Foreign
AnyPolicy = Autonomous | Operated


def named_policies(environment_id: str) -> list[str]:
    """Everything that has a name of its own in an environment, and is neither file nor Python object."""
    return [*packaged_policies(environment_id), *SCRIPTS, *controllers.registered()]


def skipped_plugins() -> list[str]:
    """Robots, tasks and controllers of other packages that cannot be used, each with the reason.

    Imports all controllers.
    """
    records = [f"{broken.name}: {broken.reason}" for broken in (*BROKEN_ROBOTS, *BROKEN_TASKS)]
    return [*records, *controllers.broken()]


def find(name: str, environment_id: str, *, allow_other_environment: bool = False) -> Autonomous:
    """Load what ``--policy`` names for an environment.

    Args:
        name: of a packaged policy, a script or a plug-in's controller, the path of a ``.safetensors`` or ``.onnx``
            file, or ``module:attribute``.
        environment_id: such as ``avrgym/FeedingJaco-v1``.
        allow_other_environment: whether a policy may run that was trained for another environment.

    Raises:
        PolicyError: for anything else, naming what is allowed, and for what cannot be loaded or does not fit.
    """
    observation_size, action_size = sizes(environment_id)
    if name in SCRIPTS:
        return Script(name)
    if name in packaged_policies(environment_id) or Path(name).is_file():
        if name.endswith(ONNX_SUFFIX):
            return find_onnx(name, environment_id, observation_size, action_size)
        return load_policy(
            name,
            environment_id,
            observation_size,
            action_size,
            allow_other_environment=allow_other_environment,
        )
    if name in controllers.registered():
        return controllers.find_registered(name)
    if ":" in name:
        return controllers.find_python(name)
    if name == OPERATOR:
        raise PolicyError(
            f"nobody can drive the robot here; {OPERATOR} is for `avrgym view`, `avrgym serve` and studies with people"
        )
    allowed = ", ".join([*named_policies(environment_id), FORMS])
    raise PolicyError(f"no policy {name!r} for {environment_id}; allowed: {allowed}")


def find_for_session(name: str, environment_id: str) -> AnyPolicy:
    """The same where an experimenter can also drive: ``operator`` is allowed too."""
    return Operated() if name == OPERATOR else find(name, environment_id)


def plugins_used(environment_id: str, policy: AnyPolicy) -> tuple[UsedPlugin, ...]:
    """The plug-ins that run when a policy drives in an environment, as they are now."""
    controller = policy.plugin if isinstance(policy, Foreign) else None
    return plugins_of(environment_id) + (() if controller is None else (controller,))


def changed_since_training(policy: Autonomous, environment_id: str) -> list[str]:
    """Which plug-ins of an environment are not what a policy was trained with, in words.

    In another environment than that of its training only those count that both have.
    """
    if not isinstance(policy, Policy):
        return []
    before, now = policy.metadata.plugins, plugins_of(environment_id)
    if policy.metadata.environment != environment_id:
        both = {each.label for each in before} & {each.label for each in now}
        before, now = (tuple(each for each in plugins if each.label in both) for plugins in (before, now))
    return differences(before, now)


@contextmanager
def acting(policy: Autonomous, world: Episodes, generators: Sequence[np.random.Generator]) -> Generator[Act]:
    """What turns observations (N, O) into actions (N, A), in a world whose episodes have begun.

    Others' controllers are one for each world, made anew. Each is seeded from its world's generator, and closed when
    all is done.

    Raises:
        PolicyError: when nobody can make one.
    """
    if not isinstance(policy, Foreign):
        yield actor(policy, world, generators)
        return
    each = [policy.make() for _ in generators]
    try:
        for controller, generator in zip(each, generators, strict=True):
            controllers.reset(controller, seed_from(generator), world.environment_id)
        yield lambda observations: np.stack(
            [controllers.answer(*pair, world.action_size) for pair in zip(each, observations, strict=True)]
        )
    finally:
        for controller in each:
            controllers.close(controller)


def actor(policy: Policy | Script, world: Episodes, generators: Sequence[np.random.Generator]) -> Act:
    """What turns observations (N, O) into actions (N, A), in a world whose episodes have begun.

    It serves these episodes only: a policy with a memory remembers them.
    """
    if isinstance(policy, Policy):
        at_work = Actor(policy, len(generators))
        return lambda observation: at_work.act(observation, generators)
    if policy.name == "zero":
        return lambda observation: np.zeros((len(observation), world.action_size), np.float32)
    if policy.name == "random":
        return lambda observation: np.stack(
            [g.uniform(-1.0, 1.0, world.action_size) for g in generators]
        ).astype(np.float32)
    return world.task.expert(world)


def seed_from(generator: np.random.Generator) -> int:
    """The seed of a controller's episode, the next number of the generator that its start was drawn from."""
    return int(generator.integers(2**31))
