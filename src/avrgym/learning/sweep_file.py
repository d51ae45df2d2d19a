"""Files that say which trainings a sweep makes: TOML, every combination of environments, people, recipes and seeds."""

from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from avrgym.learning.configuration import TrainingConfiguration, configuration_for
from avrgym.learning.settings_file import changed_settings, read_toml, refusal
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.impairments import find_impairment
from avrgym.people.population_names import ORIGINAL
from avrgym.tasks.company import find_company
from avrgym.tasks.registry import find_environment

Name = Annotated[str, Meta(pattern="^[A-Za-z0-9_]+$")]


class Stopping(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """When trainings are broken off that do worse than others: asynchronous successive halving.

    After ``after_steps``, and again each time that a training has made ``factor`` times as many, it goes on only if
    its mean reward is among the best 1/``factor`` of those that have come so far (Li et al., "A System for Massively
    Parallel Hyperparameter Tuning", MLSys 2020).
    """

    after_steps: Annotated[int, Meta(ge=1)]
    factor: Annotated[float, Meta(gt=1.0)] = 3.0


class Sweep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What is trained. A recipe, by its name, has the training settings that are other than the task's own."""

    environments: Annotated[tuple[str, ...], Meta(min_length=1)]
    steps: Annotated[int, Meta(ge=1)]
    seeds: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)] = (0,)
    people: Annotated[tuple[str, ...], Meta(min_length=1)] = (ORIGINAL,)
    impairment: str = "none"
    recipes: Annotated[dict[Name, dict[str, Any]], Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: {"usual": {}}
    )
    stopping: Stopping | None = None


class Planned(NamedTuple):
    """One training of a sweep: its folder's name, its recipe's, and what it is made of."""

    name: str
    recipe: str
    configuration: TrainingConfiguration


def read_sweep(path: Path) -> Sweep:
    """What a file says.

    Raises:
        ValueError: for a file that is no TOML, or says what cannot be, naming what is allowed.
        OSError: when it cannot be read.
    """
    said = read_toml(path)
    unknown = ", ".join(said.keys() - set(Sweep.__struct_fields__))
    if unknown:
        raise ValueError(f"{path}: a sweep has no {unknown}; allowed: {', '.join(Sweep.__struct_fields__)}")
    try:
        return msgspec.convert(said, Sweep)
    except msgspec.ValidationError as error:
        raise refusal(error, str(path)) from None


def planned(sweep: Sweep, where: str) -> dict[str, list[Planned]]:
    """The trainings, those together that are compared: in the same environment with the same people.

    Raises:
        ValueError: for an unknown environment, people, impairment or setting, naming what is allowed.
    """
    find_impairment(sweep.impairment)
    groups: dict[str, list[Planned]] = {}
    for environment, people in product(dict.fromkeys(sweep.environments), dict.fromkeys(sweep.people)):
        find_environment(environment)
        find_company(people, environment)
        groups[f"{environment} with {people}"] = [
            Planned(
                "-".join([environment.rpartition("/")[2], _plain(people), recipe, str(seed)]),
                recipe,
                configuration_for(
                    environment,
                    people if people in NAMED_DISTRIBUTIONS else str(Path(people).resolve()),
                    sweep.steps,
                    seed,
                    sweep.impairment,
                    changed_settings(settings, environment, f"{where}: recipes.{recipe}"),
                ),
            )
            for (recipe, settings), seed in product(sweep.recipes.items(), dict.fromkeys(sweep.seeds))
        ]
    return groups


def _plain(people: str) -> str:
    return people.replace("/", "_") if people in NAMED_DISTRIBUTIONS else Path(people).stem
