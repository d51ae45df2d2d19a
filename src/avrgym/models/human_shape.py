"""The person's rendered body: MuJoCo skins of a clothed man or woman, without collision.

The stored shapes have the sex's reference torso height. ``assets/human/SOURCE.md`` lists their sources.
"""

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files

import mujoco
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from avrgym.array_types import FloatArray, NumpyArray
from avrgym.geometry import transforms
from avrgym.models.collision_bits import VISUAL_GROUP
from avrgym.models.geoms import add_material
from avrgym.models.human import (
    ARM_BODIES,
    BODIES,
    BODY_DIMENSIONS,
    GIRTH_EXPONENTS,
    MOUTH_HEIGHT_M,
    PERSON_NAME_PREFIX,
    SKIN_TONES,
    BodyDimensions,
    People,
    Person,
    Posture,
    Sex,
    compute_bind_frames,
    compute_people_layout,
)


@dataclass(frozen=True)
class SkinPart:
    """A part of the rendered body, such as the shirt: its colour (``None``: the skin tone) and roughness."""

    rgb: tuple[float, float, float] | None
    roughness: float


SKIN_PARTS: Mapping[str, SkinPart] = {
    "face": SkinPart(None, 0.55),
    "body": SkinPart(None, 0.55),
    "feet": SkinPart(None, 0.55),
    "shirt": SkinPart((0.27, 0.45, 0.60), 0.9),
    "trousers": SkinPart((0.20, 0.22, 0.28), 0.9),
    "shoes": SkinPart((0.30, 0.25, 0.22), 0.6),
    "hair": SkinPart((0.30, 0.20, 0.13), 0.7),
    "eye": SkinPart((0.93, 0.92, 0.90), 0.15),
    "iris": SkinPart((0.30, 0.20, 0.12), 0.15),
    "pupil": SkinPart((0.02, 0.02, 0.02), 0.15),
    "teeth": SkinPart((0.80, 0.77, 0.70), 0.3),
    "tongue": SkinPart((0.60, 0.28, 0.26), 0.3),
}
HEAD_SKIN_PARTS = ("face", "hair", "eye", "iris", "pupil", "teeth", "tongue")
"""Parts that are hidden in the participant's first-person view."""

MESH_FILE_POSITION_RANGE_M, MESH_FILE_MOUTH_OPENING_RANGE_M, OPEN_MOUTH_FRACTION = 1.2, 0.06, 0.7
"""Ranges of stored vertex positions and stored mouth displacements in metres. The third value is the share of the
displacement for an open mouth.
"""
ARM_SEGMENTS = ("upper_arm", "forearm")
"""Arm segments that are scaled by ``Person.arm_scale``."""
HEAD_STRETCH_FRACTION = 0.5
"""Stretch of the head above the mouth, divided by the stretch of the torso. The collision sphere of the head moves by
the same distance.
"""


@dataclass(frozen=True)
class SkinMesh:
    """Skinned mesh of a rendered part, in the pose of ``compute_bind_frames``.

    ``vertices`` (V, 3), texture coordinates ``uv`` (V, 2; v points down), ``faces`` (F, 3). Each vertex is bound to
    four bodies: ``body_indices`` (V, 4) are their indices in ``BODIES``, and ``body_weights`` (V, 4) the skinning
    weights.
    """

    vertices: FloatArray
    uv: FloatArray
    faces: NDArray[np.int32]
    body_indices: NDArray[np.int64]
    body_weights: FloatArray


def add_person_skins(spec: mujoco.MjSpec, person: Person, posture: Posture, *, open_mouth: bool) -> None:
    """Add the skins of the scene's person. A person in bed has no shoes."""
    _add_materials(spec, person)
    pos, q = compute_bind_frames(
        person.sex, person.torso_height_m, person.arm_scale, person.stature_m, person.bmi_kg_m2
    )
    for name, shape in make_skin_meshes(person, open_mouth=open_mouth):
        if name == ("feet" if posture.has_shoes else "shoes"):
            continue
        skin = spec.add_skin(name=PERSON_NAME_PREFIX + name, material=_material(name), group=VISUAL_GROUP)
        skin.vert, skin.texcoord = shape.vertices.ravel(), shape.uv.ravel()
        skin.face = shape.faces.ravel()
        _bind(skin, shape, pos, q)


def _add_materials(spec: mujoco.MjSpec, person: Person) -> None:
    tone = SKIN_TONES[person.skin_tone]
    for name, part in SKIN_PARTS.items():
        add_material(spec, _material(name), part.rgb or tone, roughness=part.roughness)
    _add_texture(spec, "skin", f"{person.sex}.jpg")
    _add_texture(spec, "hair", "hair.jpg")


def _add_texture(spec: mujoco.MjSpec, material: str, file: str) -> None:
    """Add a texture to a material. The texture multiplies the material's colour."""
    name, pixels = PERSON_NAME_PREFIX + material, _pixels(file)
    texture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        colorspace=mujoco.mjtColorSpace.mjCOLORSPACE_SRGB,
        height=pixels.shape[0],
        width=pixels.shape[1],
        nchannel=pixels.shape[2],
    )
    texture.data = pixels.tobytes()
    spec.material(name).textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name


def _material(part: str) -> str:
    return PERSON_NAME_PREFIX + ("skin" if SKIN_PARTS[part].rgb is None else part)


def _bind(
    skin: mujoco.MjsSkin, shape: SkinMesh, pos: Mapping[str, FloatArray], q: Mapping[str, FloatArray]
) -> None:
    used: list[int] = np.unique(shape.body_indices[shape.body_weights > 0.0]).tolist()
    names = [BODIES[body] for body in used]
    skin.bodyname = [PERSON_NAME_PREFIX + name for name in names]
    skin.bindpos = np.concatenate([pos[name] for name in names])
    skin.bindquat = np.concatenate([q[name] for name in names])
    held = [(shape.body_indices == body) & (shape.body_weights > 0.0) for body in used]
    skin.vertid = [np.nonzero(of_body)[0].tolist() for of_body in held]
    skin.vertweight = [shape.body_weights[of_body].tolist() for of_body in held]


def make_skin_meshes(person: Person, *, open_mouth: bool) -> Iterator[tuple[str, SkinMesh]]:
    """Yields the name and mesh of each rendered part, scaled to the person's torso height and arm length."""
    for name in SKIN_PARTS:
        drawn, opening = _stored_parts(person.sex)[name]
        vertices = drawn.vertices + (OPEN_MOUTH_FRACTION if open_mouth else 0.0) * opening
        shape = _stretched(drawn, vertices, person)
        yield name, _without_arms(shape, person) if person.absent_arms else shape


def _stretched(drawn: SkinMesh, vertices: FloatArray, person: Person) -> SkinMesh:
    reference_m = BODY_DIMENSIONS[person.sex].torso_height_m
    h = person.torso_height_m / reference_m
    old_pos, q = compute_bind_frames(person.sex, reference_m)
    new_pos, _ = compute_bind_frames(
        person.sex, person.torso_height_m, person.arm_scale, person.stature_m, person.bmi_kg_m2
    )
    girths = None if person.bmi_kg_m2 is None else _girths(person)
    placed = np.zeros((len(vertices), 3))
    for number, body in enumerate(BODIES):
        weight = np.where(drawn.body_indices == number, drawn.body_weights, 0.0).sum(axis=1, keepdims=True)
        local = transforms.rotate(transforms.conjugate(q[body]), vertices - old_pos[body])
        if girths is not None:
            local = _widened(local, body, girths, BODY_DIMENSIONS[person.sex])
        placed += weight * (
            new_pos[body]
            + transforms.rotate(
                q[body],
                _lengthened(local, body, h * (person.arm_scale if body.endswith(ARM_SEGMENTS) else 1.0)),
            )
        )
    return SkinMesh(placed, drawn.uv, drawn.faces, drawn.body_indices, drawn.body_weights)


def _without_arms(shape: SkinMesh, person: Person) -> SkinMesh:
    """Returns a mesh in which absent arms end at the shoulder. Their vertices are moved to the shoulder and bound to
    the torso.
    """
    joints_w, _ = compute_bind_frames(
        person.sex, person.torso_height_m, person.arm_scale, person.stature_m, person.bmi_kg_m2
    )
    vertices, indices = shape.vertices, shape.body_indices
    for arm in person.absent_arms:
        bound = np.isin(indices, [BODIES.index(name) for name in ARM_BODIES[arm]])
        weight = np.where(bound, shape.body_weights, 0.0).sum(axis=1, keepdims=True)
        vertices = vertices + weight * (joints_w[f"{arm}_upper_arm"] - vertices)
        indices = np.where(bound, BODIES.index("torso"), indices)
    return replace(shape, vertices=vertices, body_indices=indices)


def _girths(person: Person) -> Mapping[str, float]:
    """Returns radii and breadths divided by those of the sex's reference body, by name of the measure."""
    built, reference = (
        compute_people_layout(People.from_persons([person])).dimensions,
        BODY_DIMENSIONS[person.sex],
    )
    return {name: float(getattr(built, name)[0]) / getattr(reference, name) for name in GIRTH_EXPONENTS}


def _widened(local: FloatArray, body: str, girths: Mapping[str, float], p: BodyDimensions) -> FloatArray:
    """Returns points in a body's frame, scaled across the body. On the torso, the scale depends on the height. The head
    is not scaled."""
    part = body.removeprefix("left_").removeprefix("right_")
    if part == "head":
        return local
    if part != "torso":
        across = girths[f"{part}_radius_m"]
        return local * ([across, across, across] if part == "hand" else [across, across, 1.0])
    shoulders = p.chest_offset_z_m + p.shoulder_offset_z_m
    heights = [0.0, p.chest_offset_z_m, shoulders, shoulders + 0.05]
    waist, chest, neck = (girths[f"{name}_radius_m"] for name in ("waist", "chest", "neck"))
    widths = [waist, chest, girths["shoulder_offset_x_m"], neck]
    depths = [waist, chest, girths["shoulder_radius_m"], neck]
    x, y = (np.interp(local[:, 2], heights, scales) for scales in (widths, depths))
    return local * np.stack([x, y, np.ones_like(x)], axis=-1)


def _lengthened(local: FloatArray, body: str, h: float) -> FloatArray:
    """Returns points in a body's frame, scaled by ``h`` along the body. Hands are not scaled."""
    part = body.rpartition("_")[2]
    if part == "hand":
        return local
    if part == "foot":
        return local * [1.0, h, 1.0]
    if part == "head":
        above = np.maximum(local[:, 2:] - MOUTH_HEIGHT_M, 0.0)
        return local + HEAD_STRETCH_FRACTION * (h - 1.0) * above * [0.0, 0.0, 1.0]
    return local * [1.0, 1.0, h]


@cache
def _stored_parts(sex: Sex) -> Mapping[str, tuple[SkinMesh, FloatArray]]:
    """Returns the stored parts by name, and the displacement of their vertices (V, 3) if the mouth is open."""
    with np.load(io.BytesIO(_asset(f"{sex}.npz"))) as stored:
        return {
            name: _unpacked({k: stored[f"{name}/{k}"] for k in MESH_FILE_ARRAY_NAMES}) for name in SKIN_PARTS
        }


MESH_FILE_ARRAY_NAMES = ("vertices", "opening", "uv", "faces", "bodies", "weights")


def _unpacked(stored: Mapping[str, NumpyArray]) -> tuple[SkinMesh, FloatArray]:
    shape = SkinMesh(
        vertices=MESH_FILE_POSITION_RANGE_M * stored["vertices"] / np.iinfo(np.int16).max,
        uv=stored["uv"] / np.iinfo(np.uint16).max,
        faces=stored["faces"].astype(np.int32),
        body_indices=stored["bodies"].astype(np.int64),
        body_weights=stored["weights"] / 255.0,
    )
    return shape, MESH_FILE_MOUTH_OPENING_RANGE_M * stored["opening"] / np.iinfo(np.int8).max


@cache
def _pixels(file: str) -> NDArray[np.uint8]:
    """Returns the pixels (H, W, 3) of a stored image file."""
    return np.asarray(Image.open(io.BytesIO(_asset(file))))


def _asset(name: str) -> bytes:
    return files("avrgym").joinpath("assets", "human", name).read_bytes()
