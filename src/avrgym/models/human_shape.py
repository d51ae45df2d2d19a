"""The clothed body that pictures show: lofted skins fixed to the bodies of the person.

Sizes are drawn for the man at his reference torso height; lengths scale with the torso height and girths with
the sex. It never collides.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np

from avrgym.models.parts import add_material, add_skin, add_visual
from avrgym.models.shapes import Mesh, Section, loft, tube

COLOURS: Mapping[str, tuple[float, float, float]] = {
    "skin": (0.80, 0.60, 0.48),
    "shirt": (0.24, 0.42, 0.58),
    "trousers": (0.20, 0.22, 0.27),
    "shoes": (0.32, 0.26, 0.22),
    "hair": (0.18, 0.12, 0.08),
    "eye": (0.95, 0.95, 0.94),
    "iris": (0.22, 0.16, 0.10),
    "lips": (0.68, 0.37, 0.35),
}
PREFIX = "person/"


@dataclass(frozen=True)
class Girth:
    """Widths of a sex relative to the man's drawing."""

    torso: float
    limb: float
    leg: float
    head: float


GIRTHS: Mapping[str, Girth] = {"man": Girth(1.0, 1.0, 1.0, 1.0), "woman": Girth(0.90, 0.84, 0.96, 0.94)}

# Sections: z, half width, half depth, then offsets x, y and the superellipse exponent.
SHIRT = (
    Section(-0.125, 0.150, 0.118, y=0.004), Section(-0.11, 0.166, 0.126, y=0.002),
    Section(-0.05, 0.163, 0.121), Section(0.02, 0.156, 0.113), Section(0.10, 0.163, 0.117),
    Section(0.18, 0.176, 0.122, exponent=2.2), Section(0.24, 0.186, 0.117, exponent=2.4),
    Section(0.285, 0.186, 0.100, exponent=2.5), Section(0.315, 0.178, 0.084, exponent=2.4),
    Section(0.336, 0.128, 0.072), Section(0.352, 0.074, 0.066),
)  # fmt: skip
NECK = (
    Section(0.31, 0.085, 0.070), Section(0.345, 0.062, 0.060), Section(0.39, 0.054, 0.056),
    Section(0.45, 0.055, 0.060),
)  # fmt: skip
PELVIS = (
    Section(-0.205, 0.110, 0.100), Section(-0.195, 0.150, 0.125), Section(-0.15, 0.176, 0.134),
    Section(-0.08, 0.176, 0.130), Section(-0.01, 0.164, 0.120), Section(0.015, 0.150, 0.108),
)  # fmt: skip
SLEEVE = (
    Section(0.040, 0.014, 0.016), Section(0.035, 0.034, 0.034), Section(0.016, 0.052, 0.052),
    Section(-0.02, 0.059, 0.058), Section(-0.09, 0.056, 0.056), Section(-0.155, 0.054, 0.054),
    Section(-0.158, 0.046, 0.046),
)  # fmt: skip
UPPER_ARM = (
    Section(-0.10, 0.044, 0.046), Section(-0.16, 0.045, 0.047), Section(-0.22, 0.041, 0.042),
    Section(-0.279, 0.038, 0.039), Section(-0.300, 0.032, 0.033), Section(-0.313, 0.016, 0.017),
)  # fmt: skip
FOREARM = (
    Section(0.030, 0.020, 0.020), Section(0.015, 0.035, 0.035), Section(-0.02, 0.041, 0.041),
    Section(-0.07, 0.042, 0.043), Section(-0.13, 0.036, 0.038), Section(-0.20, 0.028, 0.032),
    Section(-0.257, 0.023, 0.030), Section(-0.30, 0.022, 0.030),
)  # fmt: skip
THIGH = (
    Section(0.075, 0.040, 0.040), Section(0.06, 0.072, 0.072), Section(0.01, 0.090, 0.092),
    Section(-0.10, 0.087, 0.090), Section(-0.22, 0.078, 0.080), Section(-0.34, 0.067, 0.068),
    Section(-0.424, 0.062, 0.062), Section(-0.460, 0.052, 0.052), Section(-0.478, 0.030, 0.030),
)  # fmt: skip
SHIN = (
    Section(0.045, 0.035, 0.035), Section(0.02, 0.057, 0.058), Section(-0.08, 0.060, 0.064, y=0.006),
    Section(-0.18, 0.057, 0.061, y=0.008), Section(-0.30, 0.051, 0.054), Section(-0.375, 0.050, 0.055),
    Section(-0.378, 0.040, 0.042),
)  # fmt: skip
SHOE = (
    Section(-0.062, 0.040, 0.122, y=-0.072, exponent=2.6),
    Section(-0.060, 0.044, 0.128, y=-0.072, exponent=2.6),
    Section(-0.040, 0.045, 0.128, y=-0.072, exponent=2.5),
    Section(-0.010, 0.043, 0.112, y=-0.055, exponent=2.3), Section(0.015, 0.041, 0.075, y=-0.020),
    Section(0.040, 0.041, 0.052, y=0.002), Section(0.048, 0.036, 0.045, y=0.002),
)  # fmt: skip
HEAD = (
    Section(-0.040, 0.022, 0.022, y=-0.058), Section(-0.032, 0.038, 0.036, y=-0.056),
    Section(-0.012, 0.053, 0.056, y=-0.043), Section(0.010, 0.060, 0.073, y=-0.029),
    Section(0.030, 0.065, 0.083, y=-0.020), Section(0.060, 0.071, 0.091, y=-0.009),
    Section(0.090, 0.075, 0.096, y=-0.001), Section(0.120, 0.077, 0.099, y=0.003),
    Section(0.150, 0.073, 0.094, y=0.004), Section(0.172, 0.060, 0.078, y=0.004),
    Section(0.186, 0.038, 0.050, y=0.004), Section(0.190, 0.018, 0.024, y=0.004),
)  # fmt: skip
SHORT_HAIR = (
    Section(0.020, 0.045, 0.030, y=0.060), Section(0.050, 0.068, 0.052, y=0.056),
    Section(0.085, 0.081, 0.076, y=0.034), Section(0.120, 0.085, 0.088, y=0.022),
    Section(0.150, 0.083, 0.094, y=0.012), Section(0.175, 0.074, 0.092, y=0.004),
    Section(0.195, 0.053, 0.066, y=0.002), Section(0.205, 0.026, 0.032, y=0.002),
)  # fmt: skip
LONG_HAIR = (
    Section(-0.075, 0.040, 0.018, y=0.070), Section(-0.050, 0.070, 0.030, y=0.068),
    Section(0.0, 0.078, 0.042, y=0.062), Section(0.050, 0.082, 0.058, y=0.052), *SHORT_HAIR[2:],
)  # fmt: skip


@dataclass(frozen=True)
class Feature:
    """An ellipsoid of the face in the head's frame: centre, half axes, colour."""

    colour: str
    centre: tuple[float, float, float]
    half_axes: tuple[float, float, float]


FACE = (
    Feature("skin", (0.0, -0.106, 0.060), (0.0145, 0.017, 0.012)),
    Feature("skin", (0.0, -0.100, 0.078), (0.008, 0.013, 0.024)),
    Feature("lips", (0.0, -0.1005, 0.0345), (0.023, 0.008, 0.0055)),
    Feature("lips", (0.0, -0.0995, 0.0255), (0.020, 0.008, 0.0060)),
    *(Feature(colour, (side * x, y, z), size)
      for side in (-1.0, 1.0)
      for colour, x, y, z, size in (
          ("eye", 0.031, -0.082, 0.092, (0.0145, 0.0125, 0.0095)),
          ("iris", 0.031, -0.0915, 0.092, (0.0058, 0.0040, 0.0058)),
          ("hair", 0.032, -0.0925, 0.110, (0.0170, 0.0060, 0.0036)),
          ("skin", 0.076, 0.006, 0.075, (0.0085, 0.0190, 0.0290)))),
)  # fmt: skip


def add_appearance(
    spec: mujoco.MjSpec, bodies: Mapping[str, mujoco.MjsBody], sex: str, length_scale: float
) -> None:
    """Add the visual geoms of a person. ``length_scale``: torso height relative to the sex's reference."""
    for name, rgb in COLOURS.items():
        add_material(spec, PREFIX + name, rgb, roughness=0.8)
    girth = GIRTHS[sex]
    for body, name, colour, mesh in _skins(sex, girth, length_scale):
        add_skin(spec, bodies[body], f"{PREFIX}{name}_skin", PREFIX + colour, mesh)
    for feature in FACE:
        x, y, z = feature.centre
        add_visual(
            bodies["head"],
            mujoco.mjtGeom.mjGEOM_ELLIPSOID,
            PREFIX + feature.colour,
            pos=[x * girth.head, y * girth.head, z * length_scale],
            size=[s * girth.head for s in feature.half_axes],
        )


def _skins(sex: str, girth: Girth, h: float) -> list[tuple[str, str, str, Mesh]]:
    hair = LONG_HAIR if sex == "woman" else SHORT_HAIR
    skins = [
        ("torso", "shirt", "shirt", _scaled(SHIRT, girth.torso, h)),
        ("torso", "neck", "skin", _scaled(NECK, girth.torso, h)),
        ("hips", "pelvis", "trousers", _scaled(PELVIS, girth.torso * 1.03, h)),
        ("head", "face", "skin", _scaled(HEAD, girth.head, h)),
        ("head", "hair", "hair", _scaled(hair, girth.head, h)),
    ]
    for side in ("right", "left"):
        palm_x = 1.0 if side == "right" else -1.0
        skins += [
            (f"{side}_upper_arm", f"{side}_sleeve", "shirt", _scaled(SLEEVE, girth.limb, h)),
            (f"{side}_upper_arm", f"{side}_upper_arm", "skin", _scaled(UPPER_ARM, girth.limb, h)),
            (f"{side}_forearm", f"{side}_forearm", "skin", _scaled(FOREARM, girth.limb, h)),
            (f"{side}_thigh", f"{side}_thigh", "trousers", _scaled(THIGH, girth.leg, h)),
            (f"{side}_shin", f"{side}_shin", "trousers", _scaled(SHIN, girth.leg, h)),
            (f"{side}_foot", f"{side}_shoe", "shoes", _scaled(SHOE, girth.leg, 1.0)),
            *((f"{side}_hand", f"{side}_{name}", "skin", mesh) for name, mesh in _hand(palm_x, girth.limb)),
        ]
    return skins


def _hand(palm_x: float, girth: float) -> list[tuple[str, Mesh]]:
    """A relaxed fist around a grip: palm, four curled fingers, a thumb; the palm looks along ``palm_x``."""
    palm = [
        Section(0.010, 0.019, 0.026), Section(-0.015, 0.018, 0.030), Section(-0.045, 0.016, 0.041),
        Section(-0.075, 0.014, 0.042), Section(-0.088, 0.008, 0.036),
    ]  # fmt: skip
    parts = [("palm", _scaled(palm, girth, girth))]
    for number, y in enumerate((-0.032, -0.011, 0.010, 0.030)):
        parts.append((f"finger_{number + 1}", _finger(palm_x, y, girth)))
    thumb = np.array(
        [[0.0, -0.028, -0.020], [0.016, -0.046, -0.038], [0.030, -0.048, -0.058], [0.040, -0.040, -0.072]]
    )
    parts.append(("thumb", tube(thumb * [palm_x * girth, girth, girth], 0.0105 * girth)))
    return parts


def _finger(palm_x: float, y: float, girth: float) -> Mesh:
    turn = np.linspace(0.0, 1.25 * np.pi, 9)
    x = 0.024 * (1.0 - np.cos(turn))
    z = -0.074 - 0.028 * np.sin(turn)
    points = np.stack([palm_x * x, np.full_like(x, y), z], axis=-1)
    return tube(points * girth, 0.0098 * girth)


def _scaled(sections: Sequence[Section], girth: float, length: float) -> Mesh:
    scaled = [
        replace(s, z=s.z * length, a=s.a * girth, b=s.b * girth, x=s.x * girth, y=s.y * girth)
        for s in sections
    ]
    return loft(scaled)
