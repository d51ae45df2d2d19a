"""Surface finishes of the furniture for rendering: colour, roughness and metallic factor."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco

from avrgym.models.geoms import add_material


@dataclass(frozen=True)
class SurfaceFinish:
    """Colour (red, green, blue), roughness and metallic factor; each 0 to 1."""

    rgb: tuple[float, float, float]
    roughness: float
    metallic: float = 0.0


FURNITURE_MATERIALS: Mapping[str, SurfaceFinish] = {
    "bed_frame": SurfaceFinish((0.60, 0.63, 0.66), 0.4, metallic=0.3),
    "bracket": SurfaceFinish((0.25, 0.26, 0.28), 0.4, metallic=0.5),
    "ceramic": SurfaceFinish((0.93, 0.93, 0.90), 0.3),
    "fabric": SurfaceFinish((0.10, 0.12, 0.15), 0.95),
    "frame": SurfaceFinish((0.42, 0.10, 0.12), 0.35, metallic=0.4),
    "linen": SurfaceFinish((0.93, 0.93, 0.91), 0.95),
    "plastic": SurfaceFinish((0.87, 0.87, 0.84), 0.5),
    "porridge": SurfaceFinish((0.82, 0.56, 0.28), 0.8),
    "rubber": SurfaceFinish((0.07, 0.07, 0.075), 0.9),
    "sheet": SurfaceFinish((0.70, 0.79, 0.84), 0.95),
    "steel": SurfaceFinish((0.80, 0.81, 0.83), 0.3, metallic=0.4),
    "wood": SurfaceFinish((0.66, 0.50, 0.34), 0.6),
}


def add_furniture_material(spec: mujoco.MjSpec, name: str) -> str:
    """Add the material of the finish ``name`` to a model, unless it exists. Returns the name."""
    look = FURNITURE_MATERIALS[name]
    return add_material(spec, name, look.rgb, metallic=look.metallic, roughness=look.roughness)
