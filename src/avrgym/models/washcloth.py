"""The washcloth: a folded terry cloth, held by the ridge at its back."""

import mujoco
import numpy as np

from avrgym import transforms
from avrgym.models import contacts
from avrgym.models.parts import BOX, add_collision, add_material, add_skin
from avrgym.models.shapes import Section, loft
from avrgym.models.tools import Tool

PAD_HALF_SIZE_M = np.array([0.010, 0.050, 0.025])
"""Half of 2 × 10 × 5 cm, along the tool's x, y and z. Length and width: the reference; thickness: ours."""
PAD_CENTRE_M = np.array([-PAD_HALF_SIZE_M[0], 0.0, 0.0])
"""In the tool's frame: its origin is the middle of the face that wipes, its x that face's normal."""

_PAD_MASS_KG = 0.05
_WET_FRICTION = (0.3, 0.005, 0.0001)
_SOFT_SOLREF, _SOFT_SOLIMP = (0.05, 1.5), (0.2, 0.9, 0.015, 0.5, 2.0)
"""Several layers of wet terry give about 1 mm under 5 N and 4 mm under 20 N: our assumption."""
_THICKNESS = 2.0 * PAD_HALF_SIZE_M[0]
_LAYER_INSETS = (0.0, 0.0016, 0.0003, 0.0012)
_STRIPES_Y, _STRIPE_HALF_WIDTH = (0.034, 0.041), 0.0015
_RIDGE_HALF_THICKNESS, _RIDGE_HALF_LENGTH = 0.006, 0.043
_TERRY_RGB, _STRIPE_RGB = (0.50, 0.74, 0.86), (0.95, 0.97, 0.98)


def _build_washcloth(spec: mujoco.MjSpec, body: mujoco.MjsBody, appearance: bool) -> None:
    """A flat pad that touches, and behind it a ridge between the fingers that does not."""
    add_collision(
        body, "washcloth", BOX, contacts.TOOL, pos=PAD_CENTRE_M, size=PAD_HALF_SIZE_M, mass=_PAD_MASS_KG,
        priority=1, friction=_WET_FRICTION, solref=_SOFT_SOLREF, solimp=_SOFT_SOLIMP,
    )  # fmt: skip
    if appearance:
        _add_skins(spec, body)


def _add_skins(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    terry = add_material(spec, "terry_cloth", _TERRY_RGB, roughness=1.0)
    white = add_material(spec, "terry_stripe", _STRIPE_RGB, roughness=1.0)
    rising_along_x = transforms.from_axis_angle([0.0, 1.0, 0.0], np.asarray(0.5 * np.pi))
    skins = {f"layer_{i}": (terry, _layer(i)) for i in range(len(_LAYER_INSETS))}
    skins |= {f"stripe_{i}": (white, _stripe(y)) for i, y in enumerate(_STRIPES_Y)}
    skins["ridge"] = (terry, _ridge())
    for name, (material, sections) in skins.items():
        add_skin(spec, body, f"washcloth_{name}", material, loft(sections, segments=64), quat=rising_along_x)


def _layer(index: int) -> list[Section]:
    """One layer of the folded cloth, counted from the face, its edges rounded."""
    thickness = _THICKNESS / len(_LAYER_INSETS)
    rounding = ((0.0, 0.0024), (0.12, 0.0010), (0.5, 0.0), (0.88, 0.0010), (1.0, 0.0024))
    _, half_length, half_width = PAD_HALF_SIZE_M - _LAYER_INSETS[index]
    return [
        Section(-(index + 1.0 - share) * thickness, half_width - inset, half_length - inset, exponent=9.0)
        for share, inset in rounding
    ]


def _stripe(y: float) -> list[Section]:
    """A woven stripe across the pad."""
    half_width = PAD_HALF_SIZE_M[2] + 0.0003
    return [
        Section(x, half_width - inset, _STRIPE_HALF_WIDTH, y=y, exponent=6.0)
        for x, inset in ((-_THICKNESS, 0.002), (-0.9 * _THICKNESS, 0.0), (-0.002, 0.0), (0.0003, 0.0024))
    ]


def _ridge() -> list[Section]:
    """Gathered from the pad's back, thin where the fingers hold it: distance behind the pad, both shares."""
    outline = (
        (-0.002, 2.4, 1.06),
        (0.003, 1.2, 1.02),
        (0.006, 1.0, 1.0),
        (0.044, 1.0, 1.0),
        (0.050, 0.5, 0.95),
    )
    return [
        Section(-_THICKNESS - back, a * _RIDGE_HALF_THICKNESS, b * _RIDGE_HALF_LENGTH, exponent=4.0)
        for back, a, b in outline
    ]


WASHCLOTH = Tool("washcloth", _build_washcloth, grip_pos=(-0.062, 0.0, 0.0), particles=None)
