"""Cuts a fitted body into what is seen of it, and dresses it: shirt, trousers, shoes and hair."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import BODIES, BODY_DIMENSIONS, Sex

from .source import Source
from .surface import Surface, clip, hem, join, normals_of, shift, smooth, take

PLAIN_UV = (0.01, 0.01)
"""A place of the texture without any colour of its own."""

SLEEVE_M, HEM_M, BELT_M, CUFF_M, SHOE_TOP_M = 0.105, -0.075, 0.03, 0.020, 0.035
"""Sleeve below the shoulder; shirt's hem and trousers' top above the hips; cuff and shoe's top above the ankle."""
COLLAR_M, OVERLAP_M = 0.088, 0.018
FOREHEAD_M = (-0.088, 0.142)
NAPE_M = {"man": (0.07, 0.0), "woman": (0.055, -0.06)}
EAR_M = (-0.003, 0.070, 0.032)
"""In the head's frame, y and z: where the hair begins at the forehead and ends at the nape; middle and radius of the
ears."""
PARTING_M = 0.014
"""How far left of the middle the hair parts."""
HAIR_M = {"man": (0.0015, 0.009), "woman": (0.002, 0.014)}
"""Thickness of the hair at its edge and 5 cm above."""
STRANDS_M = 0.32
"""Side of the square of hair that the texture of its strands covers."""
IRIS_RAD, PUPIL_RAD = 0.50, 0.21


class Wardrobe:
    """What one body wears; ``local`` gives places in the frames of the skeleton's bodies."""

    def __init__(self, source: Source, weights: FloatArray, sex: Sex) -> None:
        """``source`` is fitted; ``weights`` (V, 16) are those of its vertices."""
        self._source, self._weights, self._sex = source, weights, sex
        self._pos, self._q = human.compute_bind_frames(sex, BODY_DIMENSIONS[sex].torso_height_m)

    def parts(self) -> Mapping[str, Surface]:
        """Everything that can be drawn, by name."""
        skin = self._body()
        tights = self._group("helper-tights")
        return {
            **self._skin(skin),
            "shirt": self._shirt(tights),
            "trousers": self._trousers(tights),
            "shoes": self._shoes(tights),
            "hair": self._hair(skin),
            **self._eyes(),
            "teeth": join([self._group("helper-upper-teeth"), self._group("helper-lower-teeth")]),
            "tongue": self._group("helper-tongue"),
        }

    # Surfaces of the source

    def _group(self, name: str) -> Surface:
        faces = _triangles(self._source.groups[name])
        vertices = self._source.vertices
        whole = Surface(
            vertices=vertices,
            normals=normals_of(vertices, faces),
            uv=np.tile(PLAIN_UV, (len(vertices), 1)),
            weights=self._weights,
            opening=self._source.opening,
            faces=faces,
        )
        return take(whole, faces)

    def _body(self) -> Surface:
        """The body with its texture: vertices on the seams of the texture are there once for each side."""
        faces, texture = (_triangles(q) for q in (self._source.groups["body"], self._source.uv_quads))
        pairs, corners = np.unique(np.stack([faces.ravel(), texture.ravel()]), axis=1, return_inverse=True)
        vertex, place = pairs
        return Surface(
            vertices=self._source.vertices[vertex],
            normals=normals_of(self._source.vertices, faces)[vertex],
            uv=self._source.uv[place],
            weights=self._weights[vertex],
            opening=self._source.opening[vertex],
            faces=corners.reshape(-1, 3),
        )

    # Places on the body

    def _local(self, surface: Surface, body: str) -> FloatArray:
        """The vertices in a body's frame, (V, 3)."""
        inverse = transforms.conjugate(self._q[body])
        return transforms.rotate(inverse, surface.vertices - self._pos[body])

    def _weight(self, surface: Surface, *parts: str) -> FloatArray:
        columns = [i for i, body in enumerate(BODIES) if body.endswith(parts)]
        return surface.weights[:, columns].sum(axis=1)

    def _beyond_sleeve(self, surface: Surface) -> FloatArray:
        """Metres along the upper arm past the sleeve's end; very negative away from the arms."""
        beyond = np.full(len(surface.vertices), -1.0)
        for side in ("right", "left"):
            on_arm = self._weight(surface, f"{side}_upper_arm", f"{side}_forearm", f"{side}_hand") > 0.3
            along = -self._local(surface, f"{side}_upper_arm")[:, 2] - SLEEVE_M
            beyond = np.where(on_arm, along, beyond)
        return beyond

    def _above_neckline(self, surface: Surface) -> FloatArray:
        """Metres above the shirt's round collar, which lies lower in front; large for the head."""
        x, y, z = self._local(surface, "torso").T
        p = BODY_DIMENSIONS[self._sex]
        beside = COLLAR_M - np.hypot(x, np.where(y < 0.0, 0.8, 1.0) * y)
        above = np.minimum(
            beside,
            z - (p.chest_offset_z_m + p.shoulder_offset_z_m + 0.046) - np.where(y < 0.0, 0.42, 0.8) * y,
        )
        above = np.where(self._weight(surface, "arm", "hand") > 0.3, -1.0, above)
        return np.where(self._weight(surface, "head") > 0.35, 1.0, above)

    def _above_ankle(self, surface: Surface) -> FloatArray:
        """Metres above the ankle along the shin; large away from shins and feet."""
        above = np.full(len(surface.vertices), 1.0)
        for side in ("right", "left"):
            on_leg = self._weight(surface, f"{side}_shin", f"{side}_foot") > 0.3
            above = np.where(on_leg, self._local(surface, f"{side}_foot")[:, 2], above)
        return above

    # What is seen

    def _skin(self, skin: Surface) -> dict[str, Surface]:
        bare = np.maximum(self._beyond_sleeve(skin), self._above_neckline(skin)) + OVERLAP_M
        feet = CUFF_M + OVERLAP_M - self._above_ankle(skin)
        upper = clip(skin, bare)
        return {
            "face": clip(upper, self._weight(upper, "head") - 0.5),
            "body": clip(upper, 0.5 - self._weight(upper, "head")),
            "feet": clip(skin, feet),
        }

    def _shirt(self, tights: Surface) -> Surface:
        loose = shift(smooth(tights, 6), 0.009 + 0.004 * self._weight(tights, "upper_arm"))
        above_hem = self._local(loose, "hips")[:, 2] - HEM_M
        cut = np.minimum.reduce([above_hem, -self._beyond_sleeve(loose), -self._above_neckline(loose)])
        return hem(clip(loose, cut), 0.012)

    def _trousers(self, tights: Surface) -> Surface:
        """Straight legs: the lower, the wider against the skin."""
        smoothed = smooth(tights, 5)
        above_ankle = np.minimum(self._above_ankle(smoothed), 0.4)
        loose = shift(smoothed, 0.005 + 0.013 * np.clip(1.0 - above_ankle / 0.3, 0.0, 1.0))
        below_belt = BELT_M - self._local(loose, "hips")[:, 2]
        hanging = np.where(self._weight(loose, "arm", "hand") > 0.1, -1.0, below_belt)
        return hem(clip(loose, np.minimum(hanging, self._above_ankle(loose) - CUFF_M)), 0.012)

    def _shoes(self, tights: Surface) -> Surface:
        shoe = shift(smooth(clip(tights, SHOE_TOP_M - self._above_ankle(tights)), 3), 0.006)
        vertices = shoe.vertices.copy()
        sole = self._pos["right_foot"][2] - 0.064
        low = vertices[:, 2] < sole + 0.014
        vertices[low, 2] = sole
        return hem(replace(shoe, vertices=vertices, normals=normals_of(vertices, shoe.faces)), 0.01)

    def _hair(self, skin: Surface) -> Surface:
        """A shell over the scalp, thicker away from the hairline; a woman's covers the ears, a man's does not."""
        scalp = self._scalp(skin)
        thin_m, thick_m = HAIR_M[self._sex]
        rise = np.clip(self._above_hairline(scalp) / 0.05, 0.0, 1.0) * (
            1.0 - 0.8 * self._parting(scalp, 0.007)
        )
        shell = smooth(self._without_ears(scalp, thin_m + (thick_m - thin_m) * rise), 2)
        hemmed = hem(shell, 2.0 * thin_m)
        x, y, z = self._local(hemmed, "head").T
        across, along = (x, y) if self._sex == "man" else (y, z)
        return replace(hemmed, uv=0.5 + np.stack([across, along], axis=1) / STRANDS_M)

    def _scalp(self, skin: Surface) -> Surface:
        head = _welded(clip(skin, self._weight(skin, "head") - 0.3))
        return clip(head, np.minimum(self._above_hairline(head), self._beside_ear(head)))

    def _above_hairline(self, surface: Surface) -> FloatArray:
        """Metres above a plane from the top of the forehead to the nape."""
        _, y, z = self._local(surface, "head").T
        back, low = NAPE_M[self._sex]
        share = (y - FOREHEAD_M[0]) / (back - FOREHEAD_M[0])
        raised = 0.018 * self._parting(surface, 0.024)
        return z - FOREHEAD_M[1] - share * (low - FOREHEAD_M[1]) - raised

    def _parting(self, surface: Surface, half_width_m: float) -> FloatArray:
        """How near the parting of a woman's hair is, from 0 to 1."""
        x, y, _ = self._local(surface, "head").T
        before = np.clip((0.05 - y) / 0.04, 0.0, 1.0) if self._sex == "woman" else 0.0
        return before * np.exp(-(((x - PARTING_M) / half_width_m) ** 2))

    def _beside_ear(self, surface: Surface) -> FloatArray:
        """Metres outside of the ears where the hair leaves them free."""
        if self._sex == "woman":
            return np.ones(len(surface.vertices))
        x, y, z = self._local(surface, "head").T
        beside = np.hypot((y - EAR_M[0]) / 0.8, z - EAR_M[1]) - EAR_M[2]
        return np.where(np.abs(x) > 0.05, beside, 1.0)

    def _without_ears(self, scalp: Surface, thickness_m: FloatArray) -> Surface:
        """Shifted outwards; what stands off the head, as ears do, is smoothed away below."""
        middle = self._pos["head"] + [0.0, 0.0, BODY_DIMENSIONS[self._sex].head_centre_offset_z_m]
        outward = scalp.vertices - middle
        even = smooth(scalp, 25).vertices - middle
        x, y, z = self._local(scalp, "head").T
        ear = (np.abs(x) > 0.05) & (np.hypot(y - EAR_M[0], z - EAR_M[1]) < EAR_M[2] + 0.01)
        radius = np.linalg.norm(np.where(ear[:, None], even, outward), axis=1)
        direction = outward / np.linalg.norm(outward, axis=1, keepdims=True)
        vertices = middle + direction * (radius + thickness_m)[:, None]
        return replace(scalp, vertices=vertices, normals=normals_of(vertices, scalp.faces))

    def _eyes(self) -> dict[str, Surface]:
        eyes = {"eye": [], "iris": [], "pupil": []}
        for letter in "lr":
            ball = self._group(f"helper-{letter}-eye")
            middle = 0.5 * (ball.vertices.max(axis=0) + ball.vertices.min(axis=0))
            gaze = (ball.vertices - middle) / np.linalg.norm(ball.vertices - middle, axis=1, keepdims=True)
            angle = np.arccos(np.clip(-gaze[:, 1], -1.0, 1.0))
            eyes["eye"].append(clip(ball, angle - IRIS_RAD))
            eyes["iris"].append(clip(ball, np.minimum(IRIS_RAD - angle, angle - PUPIL_RAD)))
            eyes["pupil"].append(clip(ball, PUPIL_RAD - angle))
        return {name: join(found) for name, found in eyes.items()}


def _triangles(quads: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def _welded(surface: Surface) -> Surface:
    """Vertices at the same place made one; the texture is lost."""
    _, first, welded = np.unique(surface.vertices.round(7), axis=0, return_index=True, return_inverse=True)
    return take(surface, first[welded.ravel()[surface.faces]])
