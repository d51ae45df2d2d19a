"""Reads hyperparameter files: TOML with fields of ``FeedforwardHyperparameters``. Missing fields have the task's
values.
"""

import json
import tomllib
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any, get_type_hints

import msgspec

from avrgym.learning.configuration import RENAMED_CONFIGURATION_KEYS
from avrgym.learning.hyperparameters import FeedforwardHyperparameters, make_hyperparameters
from avrgym.system.files import read_user_text
from avrgym.system.type_guards import is_array


def read_hyperparameters(path: Path, environment: str) -> FeedforwardHyperparameters:
    """Read and return the hyperparameters in a file, for an environment.

    Raises:
        ValueError: for invalid TOML, names or values. The message contains the allowed values.
        OSError: if the file cannot be read.
    """
    return change_hyperparameters(read_toml(path), environment, str(path))


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file. Returns its top-level table.

    Raises:
        ValueError: for invalid TOML.
        OSError: if the file cannot be read.
    """
    try:
        return tomllib.loads(read_user_text(path))
    except ValueError as error:
        raise ValueError(f"{path}: invalid TOML: {error}; correct this line") from None


def to_value_error(error: msgspec.ValidationError, where: str) -> ValueError:
    """Convert an error of msgspec to a ``ValueError``. The message contains ``where`` and the key of the value."""
    what, _, path = str(error).partition(" - at `$")
    place = path.strip("`.")
    return ValueError(f"{where}: {place}{': ' if place else ''}{what[:1].lower()}{what[1:]}")


def change_hyperparameters(
    changes: Mapping[str, Any], environment: str, where: str
) -> FeedforwardHyperparameters:
    """Returns the default hyperparameters of an environment, with ``changes`` applied.

    Error messages contain ``where``: the file, or a part of it.

    Raises:
        ValueError: for an unknown name or a wrong value. The message contains the allowed values.
    """
    defaults = vars(make_hyperparameters(environment))
    changes = {RENAMED_CONFIGURATION_KEYS.get(name, name): value for name, value in changes.items()}
    unknown = ", ".join(changes.keys() - defaults.keys())
    if unknown:
        raise ValueError(f"{where}: unknown hyperparameter {unknown}; allowed: {', '.join(defaults)}")
    for name, value in changes.items():
        if not all(
            isfinite(each) for each in (value if is_array(value) else [value]) if isinstance(each, float)
        ):
            raise ValueError(f"{where}: {name} is not finite; allowed: a finite number")
    try:
        return msgspec.convert({**defaults, **changes}, FeedforwardHyperparameters)
    except msgspec.ValidationError as error:
        raise to_value_error(error, where) from None


def format_hyperparameters(environment: str) -> str:
    """Returns the text of a TOML file with all hyperparameters of an environment and their descriptions."""
    values = make_hyperparameters(environment)
    lines = [
        f"# Hyperparameters of {environment}. `avrgym train --config FILE` needs only those that you change."
    ]
    for name, annotated in get_type_hints(FeedforwardHyperparameters, include_extras=True).items():
        value = getattr(values, name)
        description = annotated.__metadata__[-1].description
        lines += ["", f"# {description}", f"{name} = {json.dumps(list(value) if is_array(value) else value)}"]
    return "\n".join(lines)
