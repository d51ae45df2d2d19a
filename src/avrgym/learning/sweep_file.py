"""Sweep files: TOML with environments, people, recipes and seeds. A sweep has a training run for each combination."""

from itertools import product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec
from msgspec import Meta

from avrgym.learning.configuration import FeedforwardConfiguration, make_feedforward_configuration
from avrgym.learning.hyperparameter_files import change_hyperparameters, read_toml, to_value_error
from avrgym.people.distributions import NAMED_DISTRIBUTIONS
from avrgym.people.impairments import parse_impairment
from avrgym.people.population_names import ORIGINAL_POPULATION
from avrgym.tasks.registry import find_environment
from avrgym.tasks.world_people import find_environment_populations

RecipeName = Annotated[str, Meta(pattern="^[A-Za-z0-9_]+$")]


class EarlyStopping(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Early stopping of training runs with low rewards: asynchronous successive halving.

    Training runs are compared after ``after_steps`` steps, then after ``factor`` times this number, and so on. After
    each comparison, only the share 1/``factor`` with the highest mean reward continues (Li et al., "A System for
    Massively Parallel Hyperparameter Tuning", MLSys 2020).
    """

    after_steps: Annotated[int, Meta(ge=1)]
    factor: Annotated[float, Meta(gt=1.0)] = 3.0


class Sweep(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The contents of a sweep file. ``recipes`` maps each recipe's name to the hyperparameters that differ from the
    task's."""

    environments: Annotated[tuple[str, ...], Meta(min_length=1)]
    steps: Annotated[int, Meta(ge=1)]
    seeds: Annotated[tuple[Annotated[int, Meta(ge=0)], ...], Meta(min_length=1)] = (0,)
    people: Annotated[tuple[str, ...], Meta(min_length=1)] = (ORIGINAL_POPULATION,)
    impairment: str = "none"
    recipes: Annotated[dict[RecipeName, dict[str, Any]], Meta(min_length=1)] = msgspec.field(
        default_factory=lambda: {"usual": {}}
    )
    stopping: EarlyStopping | None = None


class PlannedTrainingRun(NamedTuple):
    """One training run of a sweep: the name of its folder, the name of its recipe, and its configuration."""

    folder_name: str
    recipe_name: str
    configuration: FeedforwardConfiguration


def read_sweep(path: Path) -> Sweep:
    """Read a sweep file. Returns its contents.

    Raises:
        ValueError: for invalid TOML, keys or values. The message contains the allowed values.
        OSError: if the file cannot be read.
    """
    values = read_toml(path)
    unknown = ", ".join(values.keys() - set(Sweep.__struct_fields__))
    if unknown:
        raise ValueError(f"{path}: unknown key {unknown}; allowed: {', '.join(Sweep.__struct_fields__)}")
    try:
        return msgspec.convert(values, Sweep)
    except msgspec.ValidationError as error:
        raise to_value_error(error, str(path)) from None


def plan_training_runs(sweep: Sweep, where: str) -> dict[str, list[PlannedTrainingRun]]:
    """Returns the training runs of a sweep by group. The runs of a group have the same environment and people.

    Raises:
        ValueError: for an unknown environment, people, impairment or setting. The message contains the allowed values.
    """
    parse_impairment(sweep.impairment)
    groups: dict[str, list[PlannedTrainingRun]] = {}
    for environment, people in product(dict.fromkeys(sweep.environments), dict.fromkeys(sweep.people)):
        find_environment(environment)
        find_environment_populations(people, environment)
        groups[f"{environment} with {people}"] = [
            PlannedTrainingRun(
                "-".join([environment.rpartition("/")[2], _people_label(people), recipe, str(seed)]),
                recipe,
                make_feedforward_configuration(
                    environment,
                    people if people in NAMED_DISTRIBUTIONS else str(Path(people).resolve()),
                    sweep.steps,
                    seed,
                    sweep.impairment,
                    change_hyperparameters(changes, environment, f"{where}: recipes.{recipe}"),
                ),
            )
            for (recipe, changes), seed in product(sweep.recipes.items(), dict.fromkeys(sweep.seeds))
        ]
    return groups


def _people_label(people: str) -> str:
    return people.replace("/", "_") if people in NAMED_DISTRIBUTIONS else Path(people).stem
