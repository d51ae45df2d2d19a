"""Writes GLB files with the features of glTF 2.0 that ``scene_export`` needs, and ``KHR_mesh_quantization``."""

import json
import struct
from collections.abc import Sequence
from typing import Any

import numpy as np

from avrgym.array_types import NumpyArray

_COMPONENT = {"int8": 5120, "uint8": 5121, "int16": 5122, "uint16": 5123, "uint32": 5125, "float32": 5126}
_VECTOR = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_ALIGNMENT = 4
_JSON_CHUNK, _BINARY_CHUNK = 0x4E4F534A, 0x004E4942


class GlbWriter:
    """Builds a glTF document. Methods that add an element return the element's index."""

    def __init__(self) -> None:
        self._binary = bytearray()
        self._lists: dict[str, list[dict[str, Any]]] = {}

    def add_element(self, kind: str, **content: Any) -> int:
        """Adds an element to one of the document's lists, such as ``nodes``. Returns its index."""
        elements = self._lists.setdefault(kind, [])
        elements.append(content)
        return len(elements) - 1

    def add_vertices(self, values: NumpyArray, *, normalized: bool = False) -> int:
        """Adds an accessor of vertex values (V, K). Rows are padded to a multiple of 4 bytes. Returns its index."""
        width = values.shape[1] * values.itemsize
        padding = -width % _ALIGNMENT
        rows = np.ascontiguousarray(values).view(np.uint8).reshape(len(values), width)
        data = np.pad(rows, ((0, 0), (0, padding))).tobytes()
        view = self._add_view(data, target=34962, byteStride=width + padding)
        bounds = {"min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist()}
        return self._add_accessor(values, view, normalized=normalized, **bounds)

    def add_indices(self, faces: NumpyArray) -> int:
        """Adds an accessor of triangles (F, 3), given as vertex indices. Returns its index."""
        kind = np.uint16 if faces.max() < np.iinfo(np.uint16).max else np.uint32
        corners = faces.astype(kind).reshape(-1, 1)
        return self._add_accessor(corners, self._add_view(corners.tobytes(), target=34963))

    def add_matrices(self, matrices: NumpyArray) -> int:
        """Adds an accessor of matrices (M, 4, 4). Returns its index."""
        columns = np.swapaxes(matrices, 1, 2).astype(np.float32).reshape(-1, 16)
        return self._add_accessor(columns, self._add_view(columns.tobytes()))

    def add_texture(self, data: bytes, mime_type: str) -> int:
        """Adds an encoded image (such as JPEG) as a texture. Returns its index."""
        image = self.add_element("images", bufferView=self._add_view(data), mimeType=mime_type)
        return self.add_element("textures", source=image, sampler=self._sampler())

    def to_bytes(self, roots: Sequence[int]) -> bytes:
        """Returns the bytes of the GLB file. ``roots``: indices of the scene's root nodes."""
        document = {
            "asset": {"version": "2.0", "generator": "AVR Gym"},
            "extensionsUsed": ["KHR_mesh_quantization"],
            "extensionsRequired": ["KHR_mesh_quantization"],
            "scene": 0,
            "scenes": [{"nodes": list(roots)}],
            "buffers": [{"byteLength": len(self._binary)}],
            **self._lists,
        }
        words = json.dumps(document, separators=(",", ":")).encode()
        chunks = _chunk(_JSON_CHUNK, words, b" ") + _chunk(_BINARY_CHUNK, bytes(self._binary), b"\0")
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _add_view(self, data: bytes, **layout: int) -> int:
        self._binary += b"\0" * (-len(self._binary) % _ALIGNMENT)
        offset = len(self._binary)
        self._binary += data
        return self.add_element("bufferViews", buffer=0, byteOffset=offset, byteLength=len(data), **layout)

    def _add_accessor(self, values: NumpyArray, view: int, **rest: Any) -> int:
        return self.add_element(
            "accessors",
            bufferView=view,
            componentType=_COMPONENT[values.dtype.name],
            count=len(values),
            type=_VECTOR[values.shape[1]],
            **rest,
        )

    def _sampler(self) -> int:
        if "samplers" not in self._lists:
            self.add_element("samplers", magFilter=9729, minFilter=9987, wrapS=33071, wrapT=33071)
        return 0


def _chunk(kind: int, data: bytes, padding: bytes) -> bytes:
    padded = data + padding * (-len(data) % _ALIGNMENT)
    return struct.pack("<II", len(padded), kind) + padded
