"""Settings of an environment: parameters of its scene and control.

Environments, commands, ``study.toml`` and recordings use the same class. The default settings change nothing.
"""

import tomllib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from avrgym.models.body_names import Side
from avrgym.models.human.anthropometry import TORSO_HEIGHT_RANGE_M

TASK_SETTINGS = ("tool", "particles", "table_offset_m")
"""Names of settings that only some tasks have."""
PERSON_SETTINGS = ("torso_height_m", "range_share")
"""Names of settings of randomly sampled people. These settings have no effect on a fixed person or a participant."""
MAX_TABLE_OFFSET_M, MAX_ROBOT_DISTANCE_M = (0.4, 0.4, 0.2), 4.0
SETTING_LIMITS: Mapping[str, tuple[float, float]] = {
    "body_mass_kg": (30.0, 200.0),
    "range_share": (0.2, 1.0),
    "seat_height_m": (0.40, 0.60),
    "bed_height_m": (0.45, 0.75),
    "backrest_deg": (40.0, 75.0),
}
"""Minimum and maximum of the settings with one number, by name of the setting."""
CONTROL_RATES_HZ = (5, 10, 20, 50)
"""Allowed control rates. Each is a multiple or divisor of the people's action rate, and a divisor of the physics rate.
"""


class Settings(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """The settings of an environment. With ``None``, the value of the task or robot is used.

    Raises:
        ValueError: for a value that is not allowed. The message contains the allowed values.
    """

    control_hz: Annotated[int, Meta(description="Rate of the robot's actions; people act at 10 Hz.")] = 10
    tool: Annotated[str | None, Meta(description="Size of the spoon or shape of the cup.")] = None
    particles: Annotated[int, Meta(ge=1, description="Pieces of food, or particles of water.")] | None = None

    table_offset_m: Annotated[
        tuple[float, float, float] | None,
        Meta(description="Position of the table relative to its default position."),
    ] = None
    robot_pose: Annotated[
        tuple[float, float, float] | None,
        Meta(
            description="Position x, y (m) and yaw (degrees) of the robot's base; without it, a search determines them."
        ),
    ] = None
    served_arm: Annotated[
        Side | None,
        Meta(
            description="Arm of the person that the robot works on; the scene is mirrored for the other arm."
        ),
    ] = None
    seat_height_m: Annotated[
        float | None, Meta(description="Height of the wheelchair's seat above the floor.")
    ] = None
    bed_height_m: Annotated[float | None, Meta(description="Height of the mattress above the floor.")] = None
    backrest_deg: Annotated[
        float | None, Meta(description="Angle of the bed's backrest above the horizontal.")
    ] = None
    torso_height_m: Annotated[
        tuple[float, float] | None, Meta(description="Range of the torso heights of randomly sampled people.")
    ] = None
    body_mass_kg: Annotated[float | None, Meta(description="Mass of every person.")] = None
    range_share: Annotated[
        float,
        Meta(
            description="Joint ranges of sampled people, as a share; multiplied by the share of impairments."
        ),
    ] = 1.0
    standing_by: Annotated[
        tuple[tuple[str, float, float, float], ...],
        Meta(description="Other robots, which do not move: name, position x, y (m) and yaw (degrees)."),
    ] = ()
    self_collision: Annotated[
        bool, Meta(description="Whether links of the robot collide with each other, also in initial states.")
    ] = False

    def __post_init__(self) -> None:
        if self.control_hz not in CONTROL_RATES_HZ:
            raise _refusal("control_hz", self.control_hz, ", ".join(map(str, CONTROL_RATES_HZ)))
        for name, poses in (
            ("robot_pose", [self.robot_pose or (0.0, 0.0, 0.0)]),
            ("standing_by", self.standing_by),
        ):
            for *_, x, y, yaw_deg in poses:
                if not (max(abs(x), abs(y)) <= MAX_ROBOT_DISTANCE_M and abs(yaw_deg) <= 360.0):
                    raise _refusal(
                        name, (x, y, yaw_deg), f"x and y up to ±{MAX_ROBOT_DISTANCE_M:g} m, yaw up to ±360°"
                    )
        within = np.abs(self.table_offset_m or (0.0, 0.0, 0.0)) <= MAX_TABLE_OFFSET_M
        if not within.all():
            x_m, _, z_m = MAX_TABLE_OFFSET_M
            allowed = f"x and y up to ±{x_m:g} m, z up to ±{z_m:g} m"
            raise _refusal("table_offset_m", self.table_offset_m, allowed)
        low, high = self.torso_height_m or TORSO_HEIGHT_RANGE_M
        lowest, highest = TORSO_HEIGHT_RANGE_M
        if not lowest <= low <= high <= highest:
            raise _refusal(
                "torso_height_m",
                (low, high),
                f"minimum and maximum in this order, both from {lowest:g} to {highest:g} m",
            )
        for name, (lowest, highest) in SETTING_LIMITS.items():
            value = getattr(self, name)
            if value is not None and not lowest <= value <= highest:
                raise _refusal(name, value, f"{lowest:g} to {highest:g}")

    @property
    def control_step_s(self) -> float:
        """Duration of a control step in seconds."""
        return 1.0 / self.control_hz

    @property
    def changed_values(self) -> dict[str, Any]:
        """Settings that differ from the defaults, as plain values by name."""
        return msgspec.to_builtins(self)

    def __str__(self) -> str:
        return (
            ", ".join(f"{name}={value}" for name, value in self.changed_values.items()) or "default settings"
        )


DEFAULT_SETTINGS = Settings()


def _refusal(name: str, value: object, allowed: str) -> ValueError:
    return ValueError(f"{name} is {value!r}; allowed: {allowed}")


def make_settings(values: Mapping[str, Any]) -> Settings:
    """Returns the settings, given plain values by name.

    Raises:
        ValueError: for an unknown name or a value that is not allowed.
    """
    unknown = ", ".join(name for name in values if name not in Settings.__struct_fields__)
    if unknown:
        raise ValueError(f"unknown setting {unknown}; allowed: {', '.join(Settings.__struct_fields__)}")
    try:
        return msgspec.convert(dict(values), Settings)
    except msgspec.ValidationError as error:
        raise ValueError(str(error).replace(" - at `$.", " in `")) from None


def parse_settings(lines: Sequence[str]) -> Settings:
    """Returns the settings, given strings ``name=value``. A value is a number, a word, or a TOML list.

    Raises:
        ValueError: for a string without this form, an unknown name, or a value that is not allowed.
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
    return make_settings(values)
