"""Serializable specs of environments. Gymnasium can create the same environment from the spec's JSON."""

import copy
from dataclasses import asdict
from enum import Enum
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from gymnasium.envs.registration import EnvSpec

from avrgym.models.human import Person
from avrgym.system.type_guards import is_array, is_table


class SerializableSpecMixin:
    """Base class of environments. Their ``spec`` contains only JSON types; its method ``encode_stage()`` therefore
    works.
    """

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> Any:
        """Gymnasium's ``EnvSpec`` of the environment, with arguments of JSON types."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = spec
        if spec is not None:
            kwargs: dict[str, Any] = to_json_types(spec.kwargs)
            steps: int | None = kwargs.pop("max_episode_steps", spec.max_episode_steps)
            self._spec = copy.copy(spec)
            self._spec.kwargs, self._spec.max_episode_steps = kwargs, steps


def to_json_types(value: Any) -> Any:
    """Converts a value to JSON types. A person or a camera becomes a dictionary of its fields."""
    if isinstance(value, Person):
        return to_json_types(asdict(value))
    if isinstance(value, msgspec.Struct):
        return to_json_types(msgspec.to_builtins(value))
    if isinstance(value, Enum):
        return to_json_types(value.value)
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()  # pyright: ignore[reportUnknownVariableType]
    if isinstance(value, Path):
        return str(value)
    if is_table(value):
        return {name: to_json_types(each) for name, each in value.items()}
    if is_array(value):
        return [to_json_types(each) for each in value]
    return value
