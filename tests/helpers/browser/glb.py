"""Reads the GLB files that ``avrgym.vr.scene.glb_writer`` writes."""

import io
import json
import struct
from typing import Any

import numpy as np
from PIL import Image

KINDS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class GlbFile:
    """The JSON document and the accessors of a GLB file (glTF 2.0)."""

    def __init__(self, data: bytes) -> None:
        magic, version, length = struct.unpack("<4sII", data[:12])
        assert (magic, version, length) == (b"glTF", 2, len(data))
        (words,) = struct.unpack("<I", data[12:16])
        self.document: dict[str, Any] = json.loads(data[20 : 20 + words])
        self._binary = data[28 + words :]

    def __getitem__(self, name: str) -> list[dict[str, Any]]:
        return self.document[name]

    def numbers(self, accessor: int) -> np.ndarray:
        """Return an accessor as rows (N, K). Normalised integers are scaled to [−1, 1]."""
        about = self["accessors"][accessor]
        view = self["bufferViews"][about["bufferView"]]
        kind, width = np.dtype(KINDS[about["componentType"]]), WIDTHS[about["type"]]
        stride = view.get("byteStride", width * kind.itemsize)
        rows = np.frombuffer(self._binary, np.uint8, about["count"] * stride, view["byteOffset"])
        packed = rows.reshape(-1, stride)[:, : width * kind.itemsize]
        values = np.ascontiguousarray(packed).view(kind)
        return values / np.iinfo(kind).max if about.get("normalized") else values

    def image_size(self, view: int) -> tuple[int, int]:
        """Return width and height of the image in a buffer view, pixels."""
        start, length = self["bufferViews"][view]["byteOffset"], self["bufferViews"][view]["byteLength"]
        return Image.open(io.BytesIO(self._binary[start : start + length])).size

    def primitives(self) -> list[dict[str, Any]]:
        return [primitive for mesh in self["meshes"] for primitive in mesh["primitives"]]

    def nodes(self, extra: str) -> dict[str, dict[str, Any]]:
        """Return the nodes that have this key in their ``extras``, by its value."""
        found = [node for node in self["nodes"] if extra in node.get("extras", {})]
        return {str(node["extras"][extra]): node for node in found}
