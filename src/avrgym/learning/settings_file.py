"""Files of training settings: TOML with any fields of ``TrainingSettings``; others are the task's own."""

import json
import tomllib
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from avrgym.system.files import read_user_text
from avrgym.system.type_guards import is_array
from avrgym.tasks.registry import TASKS, find_environment
from avrgym.tasks.training_settings import TrainingSettings


def read_settings(path: Path, environment: str) -> TrainingSettings:
    """How to train in an environment, with what a file says otherwise.

    Raises:
        ValueError: for a file that is no TOML, or says what cannot be, naming what is allowed.
        OSError: when it cannot be read.
    """
    return changed_settings(read_toml(path), environment, str(path))


def read_toml(path: Path) -> dict[str, Any]:
    """What a file says.

    Raises:
        ValueError: for a file that is no TOML.
        OSError: when it cannot be read.
    """
    try:
        return tomllib.loads(read_user_text(path))
    except ValueError as error:
        raise ValueError(f"{path}: no TOML: {error}") from None


def refusal(error: msgspec.ValidationError, where: str) -> ValueError:
    """What is wrong with a value, and the place that has it in what is said at ``where``."""
    what, _, path = str(error).partition(" - at `$")
    place = path.strip("`.")
    return ValueError(f"{where}: {place}{': ' if place else ''}{what[:1].lower()}{what[1:]}")


def changed_settings(said: Mapping[str, Any], environment: str, where: str) -> TrainingSettings:
    """How to train in an environment, with what is ``said`` otherwise.

    Raises:
        ValueError: for what cannot be, naming ``where`` it is said and what is allowed.
    """
    usual = vars(settings_of(environment))
    unknown = ", ".join(said.keys() - usual.keys())
    if unknown:
        raise ValueError(f"{where}: no training setting is called {unknown}; allowed: {', '.join(usual)}")
    for name, value in said.items():
        if not all(
            isfinite(each) for each in (value if is_array(value) else [value]) if isinstance(each, float)
        ):
            raise ValueError(f"{where}: {name}: expected a finite number")
    try:
        return msgspec.convert({**usual, **said}, TrainingSettings)
    except msgspec.ValidationError as error:
        raise refusal(error, where) from None


def settings_text(environment: str) -> str:
    """Such a file with all settings as they are in an environment, and what each means."""
    settings = settings_of(environment)
    lines = [
        f"# How a policy is trained in {environment}; `avrgym train --config FILE` takes what you change."
    ]
    for name, annotated in get_type_hints(TrainingSettings, include_extras=True).items():
        value = getattr(settings, name)
        meaning = annotated.__metadata__[-1].description
        lines += ["", f"# {meaning}", f"{name} = {json.dumps(list(value) if is_array(value) else value)}"]
    return "\n".join(lines)


def settings_of(environment: str) -> TrainingSettings:
    """How to train in an environment.

    Raises:
        ValueError: for an unknown environment, naming what there is.
    """
    task, _ = find_environment(environment)
    return TASKS[task].training
