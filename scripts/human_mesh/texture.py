"""Paints what the skin's shape does not show: lips, brows, lashes, cheeks and nails, as factors of the skin's tone."""

from collections.abc import Mapping

import numpy as np
from PIL import Image, ImageFilter

from avrgym.array_types import FloatArray
from avrgym.models.human import Sex

from .source import Source

PIXELS, HAIR_PIXELS = 1024, 256
PLAIN, LIPS, MOUTH, NAIL = (0.96, 0.96, 0.96), (0.89, 0.70, 0.68), (0.50, 0.22, 0.20), (1.0, 0.97, 0.95)
FLUSH, BROW, LASH, BEARD = (0.98, 0.86, 0.83), (0.30, 0.24, 0.21), (0.28, 0.22, 0.20), (0.90, 0.89, 0.89)


def paint(source: Source, head: FloatArray, sex: Sex, masks: Mapping[str, FloatArray]) -> Image.Image:
    """The texture of one fitted body.

    Args:
        source: for its texture places.
        head: its vertices (V, 3) in the head's frame.
        sex: of the body.
        masks: parts of the skin in the texture's space.
    """
    place = _places(source, head)
    colour = np.tile(PLAIN, (PIXELS, PIXELS, 1))
    for share, paint_rgb in _layers(place, _eye(source, head), sex, masks):
        colour += share[..., None] * (np.array(paint_rgb) - colour)
    return Image.fromarray(np.round(255.0 * colour).astype(np.uint8))


def strands(seed: int) -> Image.Image:
    """Streaks of light and dark hair, running down the picture and fading over its length."""
    random = np.random.default_rng(seed)
    fine, broad = (random.uniform(size=(2, HAIR_PIXELS // width)).repeat(width, axis=1) for width in (1, 8))
    down = np.linspace(0.0, 1.0, HAIR_PIXELS)[:, None]
    light = 0.30 + 0.40 * (fine[0] * (1.0 - down) + fine[1] * down)
    light = light + 0.30 * (broad[0] * (1.0 - down) + broad[1] * down)
    image = Image.fromarray(np.round(255.0 * light).astype(np.uint8)).filter(ImageFilter.GaussianBlur(0.7))
    return image.convert("RGB")


def _layers(place: FloatArray, eye: FloatArray, sex: Sex, masks: Mapping[str, FloatArray]):
    """Shares (PIXELS, PIXELS) of paint and its colour, from below to above."""
    x, y, z = np.abs(place[..., 0]), place[..., 1], place[..., 2]
    front = _soft(-0.045 - y, 0.02)
    cheek = _spot(x - 0.040, 0.022) * _spot(z - (eye[2] - 0.033), 0.016) * front
    nose = _spot(x, 0.014) * _spot(z - (eye[2] - 0.034), 0.012) * front
    yield 0.6 * np.maximum(cheek, nose), FLUSH
    yield 0.5 * _mask(masks["ears"], 6), FLUSH
    if sex == "man":
        yield 0.8 * _soft(0.045 - z, 0.02) * _soft(-0.01 - y, 0.03) * _soft(z + 0.06, 0.02), BEARD
    yield _mask(masks["inside-mouth"], 2), MOUTH
    yield (0.55 if sex == "man" else 1.0) * _mask(masks["lips"], 3), LIPS
    yield _mask(masks["fingernails"], 1), NAIL
    yield _brow(x, z, eye, 1.0 if sex == "man" else 0.7) * front, BROW
    yield _lashes(x, z, eye) * front, LASH


def _brow(x: FloatArray, z: FloatArray, eye: FloatArray, thickness: float) -> FloatArray:
    """An arc above the eye from near the nose outwards, thinner at its end."""
    along = (x - (eye[0] - 0.016)) / 0.040
    middle = eye[2] + 0.0165 + 0.013 * along - 0.012 * np.clip(along, 0.0, 1.0) ** 2.2
    half = thickness * 0.0042 * (1.0 - 0.6 * np.clip(along, 0.0, 1.0))
    within = _soft(along + 0.02, 0.04) * _soft(1.0 - along, 0.12)
    return 0.85 * within * np.exp(-(((z - middle) / half) ** 2))


def _lashes(x: FloatArray, z: FloatArray, eye: FloatArray) -> FloatArray:
    """A thin dark line around the opening of the eye, stronger above."""
    radius = np.hypot((x - eye[0]) / 0.0150, (z - eye[2]) / 0.0068)
    line = np.exp(-(((radius - 1.0) / 0.16) ** 2))
    return line * np.where(z > eye[2], 0.75, 0.35)


def _eye(source: Source, head: FloatArray) -> FloatArray:
    ball = head[np.unique(source.groups["helper-l-eye"])]
    return 0.5 * (ball.min(axis=0) + ball.max(axis=0))


def _spot(distance: FloatArray, width: float) -> FloatArray:
    return np.exp(-((distance / width) ** 2))


def _soft(distance: FloatArray, width: float) -> FloatArray:
    """0 below −width/2, 1 above width/2."""
    return np.clip(distance / width + 0.5, 0.0, 1.0)


def _mask(mask: FloatArray, blur: float) -> FloatArray:
    image = Image.fromarray(np.round(255.0 * mask).astype(np.uint8)).resize(
        (PIXELS, PIXELS), Image.Resampling.BOX
    )
    return np.asarray(image.filter(ImageFilter.GaussianBlur(blur)), float) / 255.0


def _places(source: Source, head: FloatArray) -> FloatArray:
    """Each texel's place in the head's frame, (PIXELS, PIXELS, 3); far away where no skin is."""
    places = np.full((PIXELS, PIXELS, 3), 9.0)
    pixel = source.uv * [PIXELS, -PIXELS] + [0.0, PIXELS] - 0.5
    quads, texture = source.groups["body"], source.uv_quads
    for corners in ((0, 1, 2), (0, 2, 3)):
        for face, spot in zip(quads[:, corners], texture[:, corners], strict=True):
            if head[face, 2].min() > -0.12 and np.abs(head[face, 0]).max() < 0.12:
                _fill(places, pixel[spot], head[face])
    return places


def _fill(places: FloatArray, corners: FloatArray, values: FloatArray) -> None:
    """Interpolate ``values`` (3, 3) over the texels of a triangle (3, 2), and a little beyond its edges."""
    low = np.maximum(np.floor(corners.min(axis=0)).astype(int), 0)
    high = np.minimum(np.ceil(corners.max(axis=0)).astype(int), PIXELS - 1)
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    edges = np.stack([corners[1] - corners[0], corners[2] - corners[0]], axis=1)
    if abs(np.linalg.det(edges)) < 1e-9:
        return
    share = (np.stack([u, v], axis=-1) - corners[0]) @ np.linalg.inv(edges).T
    inside = (share > -0.1).all(axis=-1) & (share.sum(axis=-1) < 1.1)
    value = values[0] + share @ (values[1:] - values[0])
    places[v[inside], u[inside]] = value[inside]
