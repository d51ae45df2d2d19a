"""Colours of geoms and skins as MuJoCo renders them: the colour of the geom or skin, or of its material."""

import mujoco
import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray, NumpyArray

DEFAULT_RGBA = (0.5, 0.5, 0.5, 1.0)
"""MuJoCo's default colour. Geoms and skins with this colour have the colour of their material."""


def compute_geom_colours(model: mujoco.MjModel) -> FloatArray:
    """Returns the RGBA colours (G, 4) of all geoms, 0 to 1, multiplied by the mean colours of their textures."""
    colours = _drawn(model, model.geom_matid, model.geom_rgba)
    for material in np.unique(model.geom_matid[model.geom_matid >= 0]):
        colours[model.geom_matid == material, :3] *= compute_mean_texture_colour(model, int(material))
    return colours


def compute_skin_colours(model: mujoco.MjModel) -> FloatArray:
    """Returns the RGBA colours (S, 4) of all skins, 0 to 1, without textures."""
    return _drawn(model, model.skin_matid, model.skin_rgba)


def find_texture_index(model: mujoco.MjModel, material: int) -> int:
    """Returns the index of a material's colour texture; -1 without a texture."""
    return int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB]) if material >= 0 else -1


def read_texture_pixels(model: mujoco.MjModel, texture: int) -> NDArray[np.uint8]:
    """Returns the pixels (height, width, channels) of a texture."""
    shape = model.tex_height[texture], model.tex_width[texture], model.tex_nchannel[texture]
    start = model.tex_adr[texture]
    return model.tex_data[start : start + np.prod(shape)].reshape(shape)


def compute_mean_texture_colour(model: mujoco.MjModel, material: int) -> FloatArray:
    """Returns the mean colour (3,) of a material's texture, 0 to 1; white without a texture."""
    texture = find_texture_index(model, material)
    if texture < 0:
        return np.ones(3)
    return np.broadcast_to(read_texture_pixels(model, texture)[..., :3].mean(axis=(0, 1)) / 255.0, 3)


def convert_srgb_to_linear(colours: FloatArray) -> FloatArray:
    """Convert sRGB colour values to linear values, both 0 to 1. Returns the linear values."""
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)


def _drawn(model: mujoco.MjModel, materials: NumpyArray, own: NumpyArray) -> FloatArray:
    colours = own.astype(float)
    has_material = (materials >= 0) & (own == DEFAULT_RGBA).all(axis=1)
    colours[has_material] = model.mat_rgba[materials[has_material]]
    return colours
