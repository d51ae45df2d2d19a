"""Bent bars of frames."""

import numpy as np

from avrgym.array_types import FloatArray


def rounded(points: list[list[float]], per_corner: int = 6) -> FloatArray:
    """A polyline (P, 3) with its inner corners replaced by quadratic arcs of ``per_corner`` points."""
    p = np.asarray(points, float)
    pieces = [p[:1]]
    for before, corner, after in zip(p[:-2], p[1:-1], p[2:], strict=True):
        reach = 0.35 * min(np.linalg.norm(corner - before), np.linalg.norm(after - corner))
        start = corner + reach * (before - corner) / np.linalg.norm(before - corner)
        end = corner + reach * (after - corner) / np.linalg.norm(after - corner)
        t = np.linspace(0.0, 1.0, per_corner)[:, None]
        pieces.append((1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end)
    return np.concatenate([*pieces, p[-1:]])
