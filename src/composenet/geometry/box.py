"""Axis-aligned and oriented boxes: corners, bounds, volumes of intersection, 3D IoU."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import manifold3d as m3
import numpy as np
from numpy.typing import ArrayLike, NDArray

from composenet.records import Box, FloatArray

# Bottom ring 0-3, top ring 4-7, both counter-clockwise seen from above.
_CORNER_SIGNS = np.array(
    [
        [-1, -1, -1],
        [1, -1, -1],
        [1, 1, -1],
        [-1, 1, -1],
        [-1, -1, 1],
        [1, -1, 1],
        [1, 1, 1],
        [-1, 1, 1],
    ],
    dtype=np.float64,
)


@dataclass(frozen=True)
class OrientedBox:
    """Box in object axes. center: (3,) metres, world. R: (3, 3) R_world_object. extents:
    (3,) full, metres, along the object axes."""

    center: FloatArray
    R: FloatArray
    extents: FloatArray


def aabb_of_points(points: ArrayLike) -> Box:
    """Smallest axis-aligned box around points (N, 3). Raises ValueError when there are none."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) == 0:
        raise ValueError(f"a box needs points of shape (N, 3), N > 0; got {points.shape}")
    low, high = points.min(axis=0), points.max(axis=0)
    return Box(center=(low + high) / 2, extents=high - low)


def corners(box: Box | OrientedBox) -> NDArray[np.float64]:
    """(8, 3) corners in the world: 0-3 bottom ring, 4-7 top ring, counter-clockwise."""
    offsets = _CORNER_SIGNS * (np.asarray(box.extents, dtype=np.float64) / 2)
    if isinstance(box, OrientedBox):
        offsets = offsets @ np.asarray(box.R, dtype=np.float64).T
    return offsets + box.center


def aabb_of_oriented(box: OrientedBox) -> Box:
    """Axis-aligned bounds of an oriented box."""
    extents = np.abs(box.R) @ np.asarray(box.extents, dtype=np.float64)
    return Box(center=np.asarray(box.center, dtype=np.float64), extents=extents)


def inside(points: NDArray[np.floating], box: Box) -> NDArray[np.bool_]:
    """(N,) bool: which points (N, 3) lie in the axis-aligned box, its sides included."""
    away = np.abs(points - np.asarray(box.center, dtype=points.dtype))
    return np.all(away <= np.asarray(box.extents, dtype=points.dtype) / 2, axis=1)


def pairwise_iou(a: Sequence[Box], b: Sequence[Box]) -> NDArray[np.float64]:
    """(A, B) 3D IoU of axis-aligned boxes; 0 where both are without volume."""
    if not a or not b:
        return np.zeros((len(a), len(b)))
    low_a, high_a = _bounds(a)
    low_b, high_b = _bounds(b)
    sides = np.minimum(high_a[:, None], high_b) - np.maximum(low_a[:, None], low_b)
    intersection = np.clip(sides, 0, None).prod(axis=-1)
    volume_a, volume_b = (high_a - low_a).prod(axis=-1), (high_b - low_b).prod(axis=-1)
    return _ratio(intersection, volume_a[:, None] + volume_b - intersection)


def iou(a: Box, b: Box) -> float:
    """3D IoU of two axis-aligned boxes."""
    return float(pairwise_iou([a], [b])[0, 0])


def oriented_intersection_m3(a: OrientedBox, b: OrientedBox) -> float:
    """Exact volume of intersection, cubic metres (boolean of two convex solids)."""
    apart = np.abs(np.asarray(a.center) - b.center)
    reach = (aabb_of_oriented(a).extents + aabb_of_oriented(b).extents) / 2
    if np.any(apart >= reach) or not np.all(a.extents) or not np.all(b.extents):
        return 0.0
    return max(float((_solid(a, a.center) ^ _solid(b, a.center)).volume()), 0.0)


def oriented_iou(a: OrientedBox, b: OrientedBox) -> float:
    """Exact 3D IoU of two oriented boxes; 0 where both are without volume."""
    intersection = oriented_intersection_m3(a, b)
    union = float(np.prod(a.extents) + np.prod(b.extents)) - intersection
    return intersection / union if union > 0 else 0.0


def pairwise_oriented_iou(
    a: Sequence[OrientedBox], b: Sequence[OrientedBox]
) -> NDArray[np.float64]:
    """(A, B) exact 3D IoU of oriented boxes."""
    values = [[oriented_iou(first, second) for second in b] for first in a]
    return np.array(values, dtype=np.float64).reshape(len(a), len(b))


def _bounds(boxes: Sequence[Box]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    center = np.array([box.center for box in boxes], dtype=np.float64)
    half = np.array([box.extents for box in boxes], dtype=np.float64) / 2
    return center - half, center + half


def _ratio(part: NDArray[np.float64], whole: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.divide(part, whole, out=np.zeros_like(part), where=whole > 0)


def _solid(box: OrientedBox, origin: FloatArray) -> m3.Manifold:
    """The box as a solid, about `origin` so that far-away boxes lose no precision."""
    pose = np.column_stack([box.R, np.asarray(box.center) - origin]).astype(np.float64)
    return m3.Manifold.cube(tuple(float(side) for side in box.extents), True).transform(pose)
