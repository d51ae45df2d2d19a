"""Settings of an environment: what users change in a scene and its control without a new task or robot.

Environments, commands, ``study.toml`` and recordings use the same record. With its defaults nothing changes.
"""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from avrgym.models.scene import CONTROL_STEP_S

TOOL_SETTINGS = ("tool", "particles")
"""Settings that concern the tool, which not every task has."""
CONTROL_RATES_HZ = (5, 10, 20, 50)
"""They are multiples or divisors of the rate at which people act, and divide the rate of the physics."""


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The settings of an environment; ``None`` stands for the value of the task or robot.

    Raises:
        ValueError: for a value that is not allowed, with those that are.
    """

    control_hz: Annotated[int, Meta(description="Rate of the robot's actions; people act at 10 Hz.")] = 10
    tool: Annotated[str | None, Meta(description="Size of the spoon or shape of the cup.")] = None
    particles: Annotated[int, Meta(ge=1, description="Pieces of food, or particles of water.")] | None = None

    def __post_init__(self) -> None:
        if self.control_hz not in CONTROL_RATES_HZ:
            raise _refusal("control_hz", self.control_hz, ", ".join(map(str, CONTROL_RATES_HZ)))

    @property
    def control_step_s(self) -> float:
        """Duration of a control step."""
        return CONTROL_STEP_S if self.control_hz == 10 else 1.0 / self.control_hz

    @property
    def changed(self) -> dict[str, Any]:
        """The settings that differ from the defaults, by name, in plain values."""
        return msgspec.to_builtins(self)

    def __str__(self) -> str:
        return ", ".join(f"{name}={value}" for name, value in self.changed.items()) or "default settings"


DEFAULTS = Settings()


def _refusal(name: str, value: object, allowed: str) -> ValueError:
    return ValueError(f"{name} is {value!r}; allowed: {allowed}")


def as_settings(values: Mapping[str, Any]) -> Settings:
    """Settings from plain values by name.

    Raises:
        ValueError: for an unknown name or a value that is not allowed.
    """
    unknown = ", ".join(name for name in values if name not in Settings.__struct_fields__)
    if unknown:
        raise ValueError(
            f"unknown setting {unknown}; the settings are {', '.join(Settings.__struct_fields__)}"
        )
    try:
        return msgspec.convert(dict(values), Settings)
    except msgspec.ValidationError as error:
        raise ValueError(str(error).replace(" - at `$.", " in `")) from None


def parse_settings(lines: Sequence[str]) -> Settings:
    """Settings from texts ``name=value``; a value is a number, a word, or a list as in TOML.

    Raises:
        ValueError: for a text of another form, and as ``as_settings`` does.
    """
    values: dict[str, Any] = {}
    for line in lines:
        name, equals, text = (part.strip() for part in line.partition("="))
        if not (name and equals and text):
            raise ValueError(f"the setting {line!r} has no value; allowed: name=value, such as control_hz=20")
        try:
            values[name] = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            values[name] = text
    return as_settings(values)
