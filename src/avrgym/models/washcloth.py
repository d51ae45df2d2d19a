"""The washcloth: a folded terry cloth. The robot holds the ridge at its back."""

from dataclasses import dataclass

import mujoco
import numpy as np

from avrgym.geometry import transforms
from avrgym.models import collision_bits
from avrgym.models.geoms import BOX, add_collision_geom, add_material, add_visual_mesh
from avrgym.models.shapes import CrossSection, make_loft
from avrgym.models.tools import Tool

PAD_HALF_SIZE_M = np.array([0.010, 0.050, 0.025])
"""Half the size of the pad (2 × 10 × 5 cm), along x, y and z of the tool's frame. Length and width are those of the
paper's code; the thickness is an assumption.
"""
PAD_CENTRE_M = np.array([-PAD_HALF_SIZE_M[0], 0.0, 0.0])
"""Centre of the pad in the tool's frame. The frame's origin is the middle of the wiping face, and its x axis is the
normal of this face."""
PAD_CONTACT_MARGIN_M = 0.004
"""Contact margin of the collision box. The box is smaller than the pad by this margin on each side, which rounds the
edges of the pad."""


@dataclass(frozen=True)
class _Spring:
    """Stiffness (N/m or N m/rad), damping (N s/m or N m s/rad) and inertia (kg or kg m²)."""

    stiffness: float
    damping: float
    inertia: float


_GIVE, _TILT = _Spring(1500.0, 40.0, 0.4), _Spring(4.0, 0.12, 1.2e-3)
_MAX_GIVE_M, _MAX_TILT_RAD = 0.008, 0.25
"""Maximum compression and tilt (assumption): wet terry compresses by 3 mm under 5 N and lies flat on the skin."""
_PAD_MASS_KG = 0.05
_WET_FRICTION = (0.3, 0.005, 0.0001)
_FIRM = (
    0.98,
    0.999,
    0.001,
    0.5,
    2.0,
)  # with the default impedance, this light body would penetrate other bodies
_THICKNESS = 2.0 * PAD_HALF_SIZE_M[0]
_LAYER_INSETS = (0.0, 0.0016, 0.0003, 0.0012)
_STRIPES_Y, _STRIPE_HALF_WIDTH = (0.034, 0.041), 0.0015
_RIDGE_HALF_THICKNESS, _RIDGE_HALF_LENGTH = 0.006, 0.043
_TERRY_RGB, _STRIPE_RGB = (0.50, 0.74, 0.86), (0.95, 0.97, 0.98)


def _build_washcloth(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """Build a collision pad on springs with the stiffness of the cloth, and a visual ridge between the fingers."""
    pad = body.add_body(name="washcloth", gravcomp=1.0)
    _add_springs(pad)
    add_collision_geom(
        pad, "washcloth", BOX, collision_bits.TOOL, pos=PAD_CENTRE_M, size=PAD_HALF_SIZE_M - PAD_CONTACT_MARGIN_M,
        margin=PAD_CONTACT_MARGIN_M, mass=_PAD_MASS_KG, priority=1, friction=_WET_FRICTION, solimp=_FIRM,
    )  # fmt: skip
    if appearance:
        _add_skins(spec, body, pad)


def _add_springs(pad: mujoco.MjsBody) -> None:
    """Add springs: the pad can move towards the hand, and tilt about y and z."""
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis, give, limits in (
        ("washcloth_give", slide, 0, _GIVE, (-_MAX_GIVE_M, 0.0)),
        ("washcloth_tilt_y", hinge, 1, _TILT, (-_MAX_TILT_RAD, _MAX_TILT_RAD)),
        ("washcloth_tilt_z", hinge, 2, _TILT, (-_MAX_TILT_RAD, _MAX_TILT_RAD)),
    ):
        pad.add_joint(
            name=name, type=kind, axis=np.eye(3)[axis], pos=[-_THICKNESS, 0.0, 0.0], range=limits,
            stiffness=[give.stiffness, 0.0, 0.0], damping=[give.damping, 0.0, 0.0], armature=give.inertia,
            solimp_limit=_FIRM,
        )  # fmt: skip


def _add_skins(spec: mujoco.MjSpec, body: mujoco.MjsBody, pad: mujoco.MjsBody) -> None:
    terry = add_material(spec, "terry_cloth", _TERRY_RGB, roughness=1.0)
    white = add_material(spec, "terry_stripe", _STRIPE_RGB, roughness=1.0)
    rising_along_x = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(0.5 * np.pi))
    skins = {f"layer_{i}": (pad, terry, _layer(i)) for i in range(len(_LAYER_INSETS))}
    skins |= {f"stripe_{i}": (pad, white, _stripe(y)) for i, y in enumerate(_STRIPES_Y)}
    skins["ridge"] = (body, terry, _ridge())
    for name, (owner, material, sections) in skins.items():
        add_visual_mesh(
            spec, owner, f"washcloth_{name}", material, make_loft(sections, segments=64), quat=rising_along_x
        )


def _layer(index: int) -> list[CrossSection]:
    """Returns the cross-sections of one layer of the folded cloth, with rounded edges. Layer 0 has the wiping face."""
    thickness = _THICKNESS / len(_LAYER_INSETS)
    rounding = ((0.0, 0.0024), (0.12, 0.0010), (0.5, 0.0), (0.88, 0.0010), (1.0, 0.0024))
    _, half_length, half_width = PAD_HALF_SIZE_M - _LAYER_INSETS[index]
    return [
        CrossSection(
            -(index + 1.0 - share) * thickness, half_width - inset, half_length - inset, exponent=9.0
        )
        for share, inset in rounding
    ]


def _stripe(y: float) -> list[CrossSection]:
    """Returns the cross-sections of a woven stripe across the pad."""
    half_width = PAD_HALF_SIZE_M[2] + 0.0003
    return [
        CrossSection(x, half_width - inset, _STRIPE_HALF_WIDTH, centre_y_m=y, exponent=6.0)
        for x, inset in ((-_THICKNESS, 0.002), (-0.9 * _THICKNESS, 0.0), (-0.002, 0.0), (0.0003, 0.0024))
    ]


def _ridge() -> list[CrossSection]:
    """Returns the cross-sections of the ridge at the back of the cloth. It is thin where the fingers hold it."""
    outline = (
        (-0.002, 2.4, 1.06),
        (0.003, 1.2, 1.02),
        (0.006, 1.0, 1.0),
        (0.044, 1.0, 1.0),
        (0.050, 0.5, 0.95),
    )
    return [
        CrossSection(-_THICKNESS - back, a * _RIDGE_HALF_THICKNESS, b * _RIDGE_HALF_LENGTH, exponent=4.0)
        for back, a, b in outline
    ]


WASHCLOTH = Tool(
    "washcloth", _build_washcloth, grip_pos=(-0.062, 0.0, 0.0), particles=None, contact_body="washcloth"
)
