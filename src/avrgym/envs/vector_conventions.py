"""Gymnasium's conventions for vector environments: seeds, infos and attributes."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import seeding
from numpy.typing import NDArray

from avrgym.array_types import BoolArray, NumpyArray
from avrgym.tasks.control_loop import StepOutcome

if TYPE_CHECKING:
    from avrgym.envs.vector import AssistiveVectorEnv

SeedArgument = int | np.integer | Sequence[int | None] | NDArray[np.integer] | None
"""Argument ``seed`` of ``reset``: one integer for all worlds, a sequence with one seed per world, or ``None``."""


class WorldRandomGenerators:
    """The random generators of N worlds, with their seeds."""

    def __init__(self, count: int) -> None:
        made = [seeding.np_random() for _ in range(count)]
        self.generators = [generator for generator, _ in made]
        self.seeds: list[int] = [seed for _, seed in made]

    def reseed(self, seed: SeedArgument, world_mask: BoolArray) -> None:
        """Seed the generators of the worlds in a mask (N,).

        With one seed, world i gets seed + i. With a list, world i gets the i-th seed; None does not change its
        generator.

        Raises:
            ValueError: if the number of seeds is not N.
            gymnasium.error.Error: for a negative seed.
        """
        wanted = self._one_each(seed)
        made = {i: seeding.np_random(wanted[i]) for i in np.nonzero(world_mask)[0] if wanted[i] is not None}
        for i, (generator, made_from) in made.items():
            self.generators[i], self.seeds[i] = generator, made_from

    def _one_each(self, seed: SeedArgument) -> list[int | None]:
        count = len(self.generators)
        if seed is None:
            return [None] * count
        if isinstance(seed, Iterable):
            wanted = [to_python_seed(each) for each in seed]
            if len(wanted) != count:
                raise ValueError(
                    f"seed contains {len(wanted)} seeds; allowed: one number, or a list of {count}"
                )
            return wanted
        return [int(seed) + i for i in range(count)]


NO_TIME_LIMIT = -1
"""Value of ``max_episode_steps`` for episodes without a time limit, as in ``gym.make``."""


def check_positive_integer(name: str, count: object) -> None:
    """Raises ``ValueError`` if ``count`` is not an integer of 1 or more."""
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
        raise ValueError(f"{name} is {count!r}; allowed: an integer of 1 or more")


def check_episode_length(steps: object) -> None:
    """Raises ``ValueError`` if ``steps`` is not a valid maximum number of steps of an episode."""
    if steps != NO_TIME_LIMIT:
        check_positive_integer("max_episode_steps", steps)


def to_python_seed(seed: int | np.integer | None) -> int | None:
    """Converts a seed to Python's ``int``, because Gymnasium rejects NumPy integers. Returns ``None`` unchanged."""
    return int(seed) if isinstance(seed, np.integer) else seed


def read_reset_mask(options: Mapping[str, Any] | None, count: int) -> BoolArray:
    """Returns the boolean mask (N,) of the worlds to reset: ``options["reset_mask"]``, or all worlds.

    Raises:
        ValueError: if the mask is not a boolean array (N,) with at least one ``True``.
    """
    if options is None or "reset_mask" not in options:
        return np.ones(count, dtype=bool)
    mask = np.asarray(options["reset_mask"])
    if mask.dtype != np.bool_ or mask.shape != (count,) or not mask.any():
        raise ValueError(
            f"options['reset_mask'] is {options['reset_mask']!r}; "
            f"allowed: a boolean array of shape ({count},) with at least one True"
        )
    return mask


def merge_step_outcomes(world_mask: BoolArray, some: StepOutcome, others: StepOutcome) -> StepOutcome:
    """Returns a combination of two results: ``some`` in the worlds of the mask ``world_mask`` (N,), ``others``
    elsewhere."""
    terms = {
        name: _where(world_mask, term, others.reward_terms[name]) for name, term in some.reward_terms.items()
    }
    parts: dict[str, Any] = {
        field.name: _where(world_mask, getattr(some, field.name), getattr(others, field.name))
        for field in fields(StepOutcome)
        if field.name != "reward_terms" and getattr(some, field.name) is not None
    }
    return StepOutcome(reward_terms=terms, **parts)


def _where(world_mask: BoolArray, some: NumpyArray, others: NumpyArray) -> NumpyArray:
    return np.where(world_mask.reshape(-1, *[1] * (some.ndim - 1)), some, others)


def make_vector_infos(step: StepOutcome, of: BoolArray) -> dict[str, Any]:
    """Returns Gymnasium's infos of the worlds in the mask ``of`` (N,). Values of other worlds are 0.

    For each key, the dictionary also contains a mask ``_key`` (N,) of the worlds with a value.
    """
    terms = {name: np.where(of, term, 0.0) for name, term in step.reward_terms.items()}
    found: dict[str, Any] = {
        "success": step.success & of,
        "reward_terms": _masked(terms, of),
        "force_on_person": np.where(of, step.force_on_person_n, 0.0),
    }
    if step.guard_interventions is not None:
        found["guard_interventions"] = np.where(of, step.guard_interventions, 0)
    masked = _masked(found, of)
    overridden = of if step.overridden_mask is None else of & step.overridden_mask
    if step.overridden_mask is not None and overridden.any():
        actions = np.where(overridden[:, None], step.executed_action, 0.0)
        masked |= _masked({"executed_action": actions}, overridden)
    return masked


def make_final_infos(step: StepOutcome, ended: BoolArray) -> dict[str, Any]:
    """Returns the last observations and infos of the worlds in the mask ``ended`` (N,)."""
    observations = np.full(len(ended), None, dtype=object)
    for world in np.nonzero(ended)[0]:
        observations[world] = step.observation[world].copy()
    return _masked({"final_obs": observations, "final_info": make_vector_infos(step, ended)}, ended)


def _masked(values: Mapping[str, Any], of: BoolArray) -> dict[str, Any]:
    return dict(values) | {f"_{name}": of.copy() for name in values}


class SubEnvironment:
    """One world of a vector environment, with the attributes of a single Gymnasium environment."""

    metadata: Mapping[str, Any]

    def __init__(self, env: "AssistiveVectorEnv", index: int, metadata: Mapping[str, Any]) -> None:
        self._env, self._index = env, index
        self.metadata = metadata

    def __getattr__(self, name: str) -> Any:
        allowed = ", ".join(name for name in dir(self) if not name.startswith("_"))
        raise AttributeError(f"unknown attribute {name!r} of a world; allowed: {allowed}")

    @property
    def observation_space(self) -> gym.Space[Any]:
        return self._env.single_observation_space

    @property
    def action_space(self) -> gym.Space[Any]:
        return self._env.single_action_space

    @property
    def spec(self) -> Any:
        return self._env.spec

    @property
    def render_mode(self) -> str | None:
        return self._env.render_mode

    @property
    def np_random(self) -> np.random.Generator:
        return self._env.np_random[self._index]

    @property
    def np_random_seed(self) -> int:
        return self._env.np_random_seed[self._index]

    def render(self) -> NDArray[np.uint8] | None:
        """Returns an image (480, 640, 3) in the render mode ``rgb_array``, else ``None``."""
        return self._env.render_world(self._index)
