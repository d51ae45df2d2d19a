"""Fits a source body to the skeleton of ``avrgym.models.human``: every body part placed, turned and scaled."""

from dataclasses import dataclass, replace

import numpy as np

from avrgym.array_types import FloatArray
from avrgym.geometry import transforms
from avrgym.models import human
from avrgym.models.human import BODIES, BODY_DIMENSIONS, CRANIUM_RADIUS_M, MOUTH_HEIGHT_M, Sex

from .source import Source

ANKLE_ABOVE_SOLE_M = 0.072
"""Where the source's shin ends for us: its own bone ends higher, our soles lie 5 to 6 cm below the ankle."""

BONES = {
    "hips": {"root": 1.0, "pelvis": 1.0, "spine05": 0.6, "spine04": 0.2},
    "torso": {"spine05": 0.4, "spine04": 0.8, "spine03": 1.0, "spine02": 1.0, "spine01": 1.0, "clavicle": 1.0,
              "shoulder01": 1.0, "neck01": 1.0, "neck02": 0.6, "neck03": 0.2},
    "head": {"neck02": 0.4, "neck03": 0.8, "head": 1.0, "eye": 1.0},
    "upper_arm": {"upperarm": 1.0},
    "forearm": {"lowerarm": 1.0},
    "hand": {"wrist": 1.0, "finger": 1.0, "metacarpal": 1.0},
    "thigh": {"upperleg": 1.0},
    "shin": {"lowerleg": 1.0},
    "foot": {"foot": 1.0, "toe": 1.0},
}  # fmt: skip
"""Which share of each source bone belongs to which of our bodies, by the beginning of its name."""


@dataclass(frozen=True)
class Affine:
    """A map of places (..., 3): ``matrix`` (3, 3), then ``offset`` (3,)."""

    matrix: FloatArray
    offset: FloatArray


def body_weights(source: Source) -> FloatArray:
    """Weights (V, 16) of our bodies."""
    weights = np.zeros((len(source.weights), len(BODIES)))
    for column, name in enumerate(source.bone_names):
        for body, share in _bodies_of(name).items():
            weights[:, BODIES.index(body)] += share * source.weights[:, column]
    return weights / weights.sum(axis=1, keepdims=True)


def _bodies_of(bone: str) -> dict[str, float]:
    side = {"L": "left_", "R": "right_"}.get(bone.rpartition(".")[2], "")
    return {
        (body if body in BODIES else side + body): share
        for body, shares in BONES.items()
        for begin, share in shares.items()
        if bone.startswith(begin)
    }


def fitted(source: Source, sex: Sex, weights: FloatArray) -> Source:
    """The source in our bind pose and measures."""
    maps = _maps(source, sex, weights)
    vertices = sum(
        weights[:, [i]] * (source.vertices @ maps[body].matrix.T + maps[body].offset)
        for i, body in enumerate(BODIES)
    )
    opening = source.opening @ maps["head"].matrix.T
    return replace(source, vertices=np.asarray(vertices), opening=opening)


def _maps(source: Source, sex: Sex, weights: FloatArray) -> dict[str, Affine]:
    place, _ = human.compute_bind_frames(sex, BODY_DIMENSIONS[sex].torso_height_m)
    maps = {"hips": _trunk(source, sex, place)}
    maps["torso"] = maps["hips"]
    maps["head"] = _head(source, sex, place["head"])
    for side, letter in (("right", "R"), ("left", "L")):
        chain = _source_chain(source, letter)
        for part, following in FOLLOWING.items():
            weight = weights[:, BODIES.index(f"{side}_{part}")]
            begin, end = chain[part]
            girth, beside = _girth(source, weight, begin, end, _radius(sex, part))
            middle = beside if part.endswith("arm") else np.zeros(3)
            ends = place[f"{side}_{part}"], place[f"{side}_{following}"]
            maps[f"{side}_{part}"] = _limb(begin + middle, end + middle, *ends, girth)
        maps[f"{side}_hand"] = _follow(maps[f"{side}_forearm"], chain["hand"][0], place[f"{side}_hand"])
        maps[f"{side}_foot"] = _foot(chain["foot"][0], place[f"{side}_foot"])
    return maps


FOLLOWING = {"upper_arm": "forearm", "forearm": "hand", "thigh": "shin", "shin": "foot"}


def _source_chain(source: Source, letter: str) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Begin and end (3,) of each limb's part in the source."""
    bone = source.bones
    ankle = bone[f"foot.{letter}"].copy()
    ankle[2] = source.vertices[source.groups["body"], 2].min() + ANKLE_ABOVE_SOLE_M
    joints = [bone[f"{name}.{letter}"] for name in ("upperarm01", "lowerarm01", "wrist", "finger3-1")]
    legs = [bone[f"{name}.{letter}"] for name in ("upperleg01", "lowerleg01")]
    return {
        "upper_arm": (joints[0], joints[1]),
        "forearm": (joints[1], joints[2]),
        "hand": (joints[2], joints[3]),
        "thigh": (legs[0], legs[1]),
        "shin": (legs[1], ankle),
        "foot": (ankle, bone[f"toe2-1.{letter}"]),
    }


def _radius(sex: Sex, part: str) -> float:
    return getattr(BODY_DIMENSIONS[sex], f"{part}_radius")


def _girth(
    source: Source, weight: FloatArray, begin: FloatArray, end: FloatArray, radius_m: float
) -> tuple[float, FloatArray]:
    """Scale across a limb with which the middle of its skin is as thick as its capsule, and where the skin's middle
    lies beside the bone (3,)."""
    along = (end - begin) / np.linalg.norm(end - begin)
    offset = source.vertices - begin
    share = offset @ along / np.linalg.norm(end - begin)
    middle = (weight > 0.8) & (share > 0.25) & (share < 0.75)
    across = (offset - (offset @ along)[:, None] * along)[middle]
    beside = 0.5 * (across.min(axis=0) + across.max(axis=0))
    radius = np.linalg.norm(across - beside, axis=1).mean()
    return float(np.clip(radius_m / radius, 0.8, 1.2)), beside


def _limb(
    begin: FloatArray, end: FloatArray, new_begin: FloatArray, new_end: FloatArray, girth: float
) -> Affine:
    """Turn a limb the shortest way, scale it along its axis to the new length and across by ``girth``."""
    old, new = end - begin, new_end - new_begin
    stretch = np.linalg.norm(new) / np.linalg.norm(old)
    axis = old / np.linalg.norm(old)
    scale = girth * np.eye(3) + (stretch - girth) * np.outer(axis, axis)
    turn = _shortest_turn(axis, new / np.linalg.norm(new))
    return _about(turn @ scale, begin, new_begin)


def _shortest_turn(old: FloatArray, new: FloatArray) -> FloatArray:
    cross = np.cross(old, new)
    angle = np.arctan2(np.linalg.norm(cross), old @ new)
    axis = cross / max(float(np.linalg.norm(cross)), 1e-12)
    return transforms.to_matrix(transforms.from_axis_angle(axis, angle))


def _about(matrix: FloatArray, old: FloatArray, new: FloatArray) -> Affine:
    return Affine(matrix, new - matrix @ old)


def _follow(forearm: Affine, wrist: FloatArray, new_wrist: FloatArray) -> Affine:
    """The hand turned as the forearm is, and half as much thinner."""
    u, scale, v = np.linalg.svd(forearm.matrix)
    return _about(np.sqrt(min(scale)) * u @ v, wrist, new_wrist)


def _trunk(source: Source, sex: Sex, place: dict[str, FloatArray]) -> Affine:
    """Hips and torso: as long as from our hip joints to our shoulders, as wide as between the shoulders."""
    hip, shoulder = source.bones["upperleg01.L"], source.bones["upperarm01.L"]
    new_hip = place["left_thigh"]
    new_shoulder = place["left_upper_arm"]
    scale = np.array([new_shoulder[0] / shoulder[0], 1.0, (new_shoulder - new_hip)[2] / (shoulder - hip)[2]])
    scale[1] = 0.5 * (scale[0] + scale[2])
    middle = 0.5 * (hip + shoulder) * [0.0, 1.0, 1.0]
    new_middle = 0.5 * (new_hip + new_shoulder) * [0.0, 1.0, 1.0]
    return _about(np.diag(scale), middle, new_middle)


def _head(source: Source, sex: Sex, joint: FloatArray) -> Affine:
    """Lips at our mouth, crown and back of the head where the collision sphere ends."""
    p = BODY_DIMENSIONS[sex]
    head = source.vertices[source.groups["body"]].reshape(-1, 3)
    head = head[head[:, 2] > source.bones["head"][2] - 0.02]
    lips = _lips(source)
    top, back = head[:, 2].max(), head[:, 1].max()
    high = (p.head_centre_offset_z_m + 0.015 + CRANIUM_RADIUS_M - MOUTH_HEIGHT_M) / (top - lips[2])
    deep = (p.mouth_forward_offset_m + CRANIUM_RADIUS_M) / (back - lips[1])
    scale = np.diag([0.5 * (high + deep), deep, high])
    return _about(scale, lips, joint + np.array([0.0, -p.mouth_forward_offset_m, MOUTH_HEIGHT_M]))


def _lips(source: Source) -> FloatArray:
    """Where the closed lips meet, at their foremost: half way between what goes down when the jaw opens and what
    stays, on the middle line."""
    lower = np.linalg.norm(source.opening, axis=1) > 0.003
    middle = np.abs(source.vertices[:, 0]) < 0.004
    body = np.zeros(len(lower), bool)
    body[np.unique(source.groups["body"])] = True
    front = source.vertices[:, 1] < source.vertices[lower & middle & body, 1].min() + 0.012
    jaw = source.vertices[lower & middle & body & front]
    seam = jaw[:, 2].max()
    return np.array([0.0, jaw[:, 1].min(), seam])


def _foot(ankle: FloatArray, new_ankle: FloatArray) -> Affine:
    """Turned straight ahead, and as low as our soles."""
    return _about(np.diag([1.0, 1.0, SOLE_M / ANKLE_ABOVE_SOLE_M]), ankle, new_ankle)


SOLE_M = 0.058
"""How far below the ankle the bare sole is."""


def curled(source: Source, degrees: tuple[float, float, float]) -> Source:
    """The fingers bent at their three joints, as a hand rests or holds something thick."""
    vertices = source.vertices.copy()
    for letter in "LR":
        vertices = _curl_hand(replace(source, vertices=vertices), letter, np.radians(degrees))
    return replace(source, vertices=vertices)


def _curl_hand(source: Source, letter: str, angles: FloatArray) -> FloatArray:
    bones = source.bones
    across = bones[f"finger5-1.{letter}"] - bones[f"finger2-1.{letter}"]
    if letter == "R":
        across = -across
    moved = source.vertices.copy()
    for finger in range(2, 6):
        names = [f"finger{finger}-{k}.{letter}" for k in (1, 2, 3)]
        matrix, offset = np.eye(3), np.zeros(3)
        for name, angle in zip(names, angles, strict=True):
            weight = source.weights[:, [source.bone_names.index(name)]]
            turn = transforms.to_matrix(transforms.from_axis_angle(across / np.linalg.norm(across), angle))
            pivot = bones[name]
            offset = offset + matrix @ (pivot - turn @ pivot)
            matrix = matrix @ turn
            moved += weight * (source.vertices @ matrix.T + offset - source.vertices)
    return moved
