"""Curved and tapering solids of which chairs, tables and sofas are made."""

from __future__ import annotations

from collections.abc import Sequence

import manifold3d as m3
import numpy as np
from numpy.typing import ArrayLike, NDArray

from composenet.synth.furniture.parts import Solid, loft

_SQUARE = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])


def plate(grid: ArrayLike, thickness: ArrayLike) -> Solid:
    """A curved board about a surface.

    grid: (R, C, 3) points; it faces the side from which rows x columns is the normal.
    thickness: metres, a number or (R, C), all positive.
    """
    points = np.asarray(grid, dtype=float)
    rows, columns = points.shape[:2]
    normal = np.cross(np.gradient(points, axis=0), np.gradient(points, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    half = np.broadcast_to(np.asarray(thickness, dtype=float) / 2, (rows, columns))[..., None]
    index = np.arange(rows * columns).reshape(rows, columns)
    front = _grid_faces(index)
    rim = np.concatenate([index[:-1, 0], index[-1, :-1], index[:0:-1, -1], index[0, :0:-1]])
    after, behind = np.roll(rim, -1), rows * columns
    side = [
        np.stack([rim + behind, after + behind, after], axis=1),
        np.stack([rim + behind, after, rim], axis=1),
    ]
    vertices = np.concatenate([points + half * normal, points - half * normal]).reshape(-1, 3)
    faces = np.concatenate([front, front[:, ::-1] + behind, *side]).astype(np.uint32)
    return Solid(m3.Mesh(vertices.astype(np.float32), faces))


def post(path: ArrayLike, sizes: ArrayLike, segments: int = 4) -> Solid:
    """A leg or post along a rising polyline, cut horizontally.

    path: (P, 3). sizes: full widths, one number, (P,) or (P, 2) along X and Y.
    segments: 4 for a square section, more for a round one.
    """
    points = np.asarray(path, dtype=float)
    full = np.asarray(sizes, dtype=float)
    full = full[:, None] if full.ndim == 1 else full
    full = np.broadcast_to(full, (len(points), 2))
    angle = np.arange(segments) * 2 * np.pi / segments
    outline = _SQUARE if segments == 4 else np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rings = np.repeat(points[:, None, :], segments, axis=1)
    rings[..., :2] += outline * full[:, None, :] / 2
    return loft(rings)


def soft_slab(outline: ArrayLike, base_z: float, thickness: float, edge: float) -> Solid:
    """A slab over a convex outline (K, 2) with rounded edges: seats, cushions, table tops."""
    flat = np.asarray(outline, dtype=float)
    center = (flat.min(axis=0) + flat.max(axis=0)) / 2
    half = np.abs(flat - center).max(axis=0)
    edge = min(edge, 0.45 * thickness)
    insets = edge * np.array([1.0, 0.3, 0.0, 0.0, 0.3, 1.0])
    lifts = np.array([0.0, 0.3 * edge, edge, thickness - edge, thickness - 0.3 * edge, thickness])
    rings = [
        np.column_stack([center + (flat - center) * (1 - inset / half), np.full(len(flat), lift)])
        for inset, lift in zip(insets, base_z + lifts, strict=True)
    ]
    return loft(np.stack(rings))


def bent_path(corners: Sequence[object], radius: float, steps: int = 3) -> NDArray[np.float64]:
    """A polyline (P, 3) for bent tubes through corners, (3,) each.

    Inner corners are replaced by curves that leave and join the straight runs `radius` away
    (less where runs are short).
    """
    points = [np.asarray(corner, dtype=float) for corner in corners]
    path = [points[0]]
    for before, corner, after in zip(points, points[1:], points[2:], strict=False):
        reach_in, reach_out = before - corner, after - corner
        cut = min(radius, 0.45 * min(np.linalg.norm(reach_in), np.linalg.norm(reach_out)))
        start = corner + cut * reach_in / np.linalg.norm(reach_in)
        end = corner + cut * reach_out / np.linalg.norm(reach_out)
        for t in np.linspace(0, 1, steps + 1):
            path.append((1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end)
    return np.array([*path, points[-1]])


def _grid_faces(index: NDArray[np.int_]) -> NDArray[np.int_]:
    """(F, 3) triangles over a grid of vertex numbers, facing rows x columns."""
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
